// Charts: a figure with a title, a drawing that tells its numbers on hover, a legend, and the numbers as a table.

const CHART = { width: 600, height: 330, left: 58, right: 16, top: 12, bottom: 44 };

function html(name, properties = {}, ...children) {
  const element = Object.assign(document.createElement(name), properties);
  element.append(...children);
  return element;
}

/** Rounded positions from low to high, about `count` of them. */
function ticks(low, high, count) {
  const span = high - low || 1;
  const power = 10 ** Math.floor(Math.log10(span / count));
  const step = [1, 2, 2.5, 5, 10].map((each) => each * power).find((each) => span / each <= count);
  const found = [];
  for (let at = Math.ceil(low / step - 1e-9) * step; at <= high + step * 1e-6; at += step) found.push(+at.toPrecision(12));
  return found;
}

const told = (value) => (Number.isInteger(value) ? String(value) : String(+value.toPrecision(4)));

class Axes {
  constructor(figure, x, y, labels) {
    const { width, height, left, right, top, bottom } = CHART;
    this.area = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": labels.title }, figure);
    this.scale = {
      x: (value) => left + ((value - x[0]) / (x[1] - x[0] || 1)) * (width - left - right),
      y: (value) => height - bottom - ((value - y[0]) / (y[1] - y[0] || 1)) * (height - top - bottom),
    };
    for (const at of ticks(...y, 5)) {
      svg("line", { x1: left, x2: width - right, y1: this.scale.y(at), y2: this.scale.y(at), class: "grid" }, this.area);
      this.text(left - 8, this.scale.y(at) + 4, told(at), "end");
    }
    for (const at of ticks(...x, 7)) this.text(this.scale.x(at), height - bottom + 18, told(at), "middle");
    svg("line", { x1: left, x2: width - right, y1: height - bottom, y2: height - bottom, class: "axis" }, this.area);
    this.text((left + width - right) / 2, height - 6, labels.x, "middle", "label");
    const turned = this.text(0, 0, labels.y, "middle", "label");
    turned.setAttribute("transform", `translate(14 ${(top + height - bottom) / 2}) rotate(-90)`);
  }

  text(x, y, content, anchor, kind = "tick") {
    const element = svg("text", { x, y, "text-anchor": anchor, class: kind }, this.area);
    element.textContent = content;
    return element;
  }

  line(points, attributes) {
    const d = points.map(([x, y], k) => `${k ? "L" : "M"}${this.scale.x(x).toFixed(2)} ${this.scale.y(y).toFixed(2)}`);
    return svg("path", { d: d.join(""), fill: "none", ...attributes }, this.area);
  }

  /** Call back with the x of the pointer, and with null when it has gone. */
  follow(callback) {
    const { width, left, right } = CHART;
    this.area.addEventListener("pointermove", (event) => {
      const box = this.area.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * width;
      callback(x < left || x > width - right ? null : (x - left) / (width - left - right));
    });
    this.area.addEventListener("pointerleave", () => callback(null));
  }
}

function colourOf(series, index) {
  if (series.colour) return series.colour;
  if (series.role === "plan") return "var(--strong)";
  if (series.role === "faint") return "var(--faint)";
  return ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9"][index % 6];
}

function drawLines(figure, spec) {
  const all = spec.series.flatMap((series) => series.points);
  const xs = all.map((point) => point[0]);
  const ys = [...all.map((point) => point[1]), ...spec.levels.map((level) => level.y)];
  const top = spec.top ?? Math.max(...ys, 1e-9) * 1.06;
  const x = [Math.min(0, ...xs), Math.max(...xs)];
  if (spec.x === "epoch" || spec.x.startsWith("score tables")) x[0] = Math.min(...xs);
  const axes = new Axes(figure, x, [Math.min(0, ...ys), top], spec);
  for (const level of spec.levels) {
    axes.line([[x[0], level.y], [x[1], level.y]], { class: "level" });
    axes.text(CHART.width - CHART.right, axes.scale.y(level.y) - 5, `${level.name} ${told(level.y)}`, "end");
  }
  const drawn = [...spec.series].sort((one, other) => (one.role === "plan") - (other.role === "plan"));
  for (const series of drawn) {
    const width = series.role === "plan" ? 2.8 : 1.5;
    axes.line(series.points, { stroke: colourOf(series, spec.series.indexOf(series)), "stroke-width": width });
    if (series.points.length < 3) {
      for (const [px, py] of series.points) svg("circle", { cx: axes.scale.x(px), cy: axes.scale.y(py), r: 3, fill: colourOf(series, 0) }, axes.area);
    }
  }
  const legend = html("ul", { className: "legend" });
  const rows = spec.series.map((series, index) => {
    const number = html("b");
    const swatch = html("i");
    swatch.style.background = colourOf(series, index);
    legend.append(html("li", {}, swatch, ` ${series.name} `, number));
    return [series, number];
  });
  figure.append(legend);
  const rule = svg("line", { y1: CHART.top, y2: CHART.height - CHART.bottom, class: "rule" }, axes.area);
  axes.follow((share) => {
    rule.style.display = share === null ? "none" : "";
    const at = share === null ? x[1] : x[0] + share * (x[1] - x[0]);
    rule.setAttribute("x1", axes.scale.x(at));
    rule.setAttribute("x2", axes.scale.x(at));
    for (const [series, number] of rows) {
      const before = series.points.filter((point) => point[0] <= at + 1e-9);
      number.textContent = before.length ? told(before[before.length - 1][1]) : "";
    }
  });
  rule.style.display = "none";
  for (const [series, number] of rows) number.textContent = told(series.points[series.points.length - 1]?.[1] ?? 0);
  return [["", spec.x, spec.y], ...spec.series.flatMap((s) => s.points.map((point) => [s.name, ...point]))];
}

function drawSteps(figure, spec) {
  const top = Math.max(...spec.values) * 1.08;
  const axes = new Axes(figure, [spec.edges[0], spec.edges[spec.edges.length - 1]], [0, top], spec);
  spec.values.forEach((value, k) => {
    const [x0, x1] = [axes.scale.x(spec.edges[k]), axes.scale.x(spec.edges[k + 1])];
    const y = axes.scale.y(value);
    const bar = svg("rect", { x: x0, y, width: Math.max(1, x1 - x0 - 1), height: axes.scale.y(0) - y, class: "bar" }, axes.area);
    svg("title", {}, bar).textContent = `${told(spec.edges[k])} to ${told(spec.edges[k + 1])} m: ${told(value)} %`;
  });
  if (spec.mark.x !== null) {
    axes.line([[spec.mark.x, 0], [spec.mark.x, top]], { class: "mark" });
    const x = axes.scale.x(spec.mark.x);
    const side = x > 0.7 * CHART.width ? -6 : 6;
    axes.text(x + side, CHART.top + 12, `${spec.mark.name} ${told(spec.mark.x)}`, side < 0 ? "end" : "start");
  }
  return [[spec.x, spec.y], ...spec.values.map((value, k) => [spec.edges[k], value])];
}

function drawScores(figure, spec) {
  const row = 34;
  const height = row * spec.rows.length + 52;
  const [left, right] = [150, 110];
  const width = CHART.width;
  const area = svg("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": spec.title }, figure);
  const at = (value) => left + value * (width - left - right);
  const text = (x, y, content, anchor, kind = "tick") => {
    svg("text", { x, y, "text-anchor": anchor, class: kind }, area).textContent = content;
  };
  for (const tick of [0, 0.25, 0.5, 0.75, 1]) {
    svg("line", { x1: at(tick), x2: at(tick), y1: 6, y2: height - 44, class: "grid" }, area);
    text(at(tick), height - 28, told(tick), "middle");
  }
  text(at(0.5), height - 8, "expected score, and one standard deviation either way", "middle", "label");
  spec.rows.forEach((entry, k) => {
    const y = 6 + row * (k + 0.5);
    svg("rect", { x: 4, y: y - 6, width: 12, height: 12, fill: entry.colour }, area);
    text(22, y + 4, entry.name.slice(0, 18), "start");
    text(width - 4, y + 4, entry.detail, "end");
    for (const [state, shift] of [["before", -5], ["after", 5]]) {
      const { mean, sd } = entry[state];
      const [low, high] = [Math.max(0, mean - sd), Math.min(1, mean + sd)];
      const fill = state === "after" ? entry.colour : "none";
      svg("line", { x1: at(low), x2: at(high), y1: y + shift, y2: y + shift, class: `spread ${state}` }, area);
      const dot = svg("circle", { cx: at(mean), cy: y + shift, r: 4.5, fill, class: `belief ${state}` }, area);
      svg("title", {}, dot).textContent = `${entry.name}, ${state}: ${told(mean)} ± ${told(sd)}`;
    }
  });
  figure.append(html("ul", { className: "legend" }, html("li", {}, "○ before"), html("li", {}, "● after")));
  const values = (entry, state) => [entry[state].mean, entry[state].sd];
  const head = ["class", "before", "sd", "after", "sd", ""];
  return [head, ...spec.rows.map((entry) => [entry.name, ...values(entry, "before"), ...values(entry, "after"), entry.detail])];
}

function drawReliability(figure, spec) {
  const axes = new Axes(figure, [0, 1], [0, 1], { ...spec, x: "confidence", y: "share that was right" });
  axes.line([[0, 0], [1, 1]], { class: "level" });
  const most = Math.max(...spec.bins.map((bin) => bin.count), 1);
  spec.bins.forEach((bin, k) => {
    if (!bin.count) return;
    const [x0, x1] = [axes.scale.x(k / spec.bins.length), axes.scale.x((k + 1) / spec.bins.length)];
    const y = axes.scale.y(bin.accuracy);
    const bar = svg("rect", { x: x0 + 2, y, width: x1 - x0 - 4, height: axes.scale.y(0) - y, class: "bar" }, axes.area);
    bar.style.opacity = 0.35 + 0.65 * Math.sqrt(bin.count / most);
    svg("title", {}, bar).textContent = `confidence ${told(bin.confidence)}: right ${told(bin.accuracy)}, ${bin.count} frames`;
    svg("circle", { cx: axes.scale.x(bin.confidence), cy: y, r: 4, class: "mark dot" }, axes.area);
  });
  figure.append(html("p", { className: "detail" }, `${spec.detail}. The fainter a bar, the fewer frames it stands for.`));
  return [["confidence", "right", "frames"], ...spec.bins.map((bin) => [bin.confidence, bin.accuracy, bin.count])];
}

const DRAW = { lines: drawLines, steps: drawSteps, scores: drawScores, reliability: drawReliability };

function showChart(spec) {
  const figure = html("figure", { className: "chart" }, html("figcaption", {}, spec.title));
  const table = DRAW[spec.type](figure, spec);
  const numbers = html("details", {}, html("summary", {}, "numbers"));
  numbers.addEventListener("toggle", () => {
    if (numbers.open && !numbers.querySelector("table")) numbers.append(tableOf(table));
  });
  figure.append(numbers);
  return figure;
}
