// Data that the page carries within it.

/** Bytes of what `pictures.packed` wrote: base64 of a deflated array. */
async function unpacked(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

const rgbOf = (colour) => [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));

/** A colour [r, g, b] of a ramp of stops [share, "#rrggbb"] at a share of 0 to 1. */
function onRamp(ramp, share) {
  let above = ramp.findIndex(([stop]) => stop >= share);
  if (above < 0) above = ramp.length - 1;
  if (above === 0) return rgbOf(ramp[0][1]);
  const [low, high] = [ramp[above - 1], ramp[above]];
  const part = Math.min(1, (share - low[0]) / (high[0] - low[0]));
  const [from, to] = [rgbOf(low[1]), rgbOf(high[1])];
  return from.map((value, k) => Math.round(value + part * (to[k] - value)));
}

function canvasOf(cols, rows, pixels) {
  const canvas = document.createElement("canvas");
  canvas.width = cols;
  canvas.height = rows;
  canvas.getContext("2d").putImageData(new ImageData(pixels, cols, rows), 0, 0);
  return canvas;
}

/** A layer of class ids as a picture. */
function paintedIds(layer, ids) {
  const colours = new Map(layer.legend.map((entry) => [entry.id, rgbOf(entry.colour)]));
  const pixels = new Uint8ClampedArray(4 * ids.length);
  ids.forEach((id, k) => {
    const colour = id === layer.nodata ? undefined : colours.get(id);
    if (colour) pixels.set([...colour, 255], 4 * k);
  });
  return canvasOf(layer.cols, layer.rows, pixels);
}

/** A layer of levels, 0 where there is no value, as a picture. */
function paintedValues(layer, levels) {
  const table = Array.from({ length: 256 }, (_, k) => onRamp(layer.ramp, k / 255));
  const pixels = new Uint8ClampedArray(4 * levels.length);
  levels.forEach((level, k) => {
    if (level > 0) pixels.set([...table[Math.round(((level - 1) / 65534) * 255)], 255], 4 * k);
  });
  return canvasOf(layer.cols, layer.rows, pixels);
}

function pictureOf(address) {
  return new Promise((resolve, reject) => {
    const picture = new Image();
    picture.onload = () => resolve(picture);
    picture.onerror = () => reject(new Error("a picture of this page is damaged"));
    picture.src = address;
  });
}

/** Give a layer its `picture` to draw, and `values` or `ids` to read off. */
async function prepareLayer(layer) {
  if (layer.type === "area") return;
  if (layer.data) {
    const bytes = await unpacked(layer.data);
    if (layer.type === "ids") layer.ids = bytes;
    else layer.levels = new Uint16Array(bytes.buffer);
    delete layer.data;
  }
  if (layer.type === "ids") layer.picture = paintedIds(layer, layer.ids);
  else if (layer.type === "values") layer.picture = paintedValues(layer, layer.levels);
  else layer.picture = await pictureOf(layer.href);
}
