// The map: layers on a canvas, plans and drives as vectors over it. Metres east and north, north up.

const SVG = "http://www.w3.org/2000/svg";
const HOVER_PX = 14;
const CROWDED_PX = 9;

function svg(name, attributes = {}, parent = null) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  if (parent) parent.append(element);
  return element;
}

class SiteMap {
  constructor(frame) {
    this.frame = frame;
    this.canvas = frame.querySelector("canvas");
    this.overlay = frame.querySelector(":scope > svg");
    this.tip = frame.querySelector(".tip");
    this.pointers = new Map();
    this.listen();
    new ResizeObserver(() => this.resize()).observe(frame);
  }

  async show(site) {
    this.site = site;
    this.overlay.replaceChildren();
    this.lines = svg("g", { class: "lines" }, this.overlay);
    this.marks = svg("g", { class: "marks" }, this.overlay);
    this.hits = [];
    for (const plan of site.plans) this.addPlan(plan);
    for (const drive of site.drives) this.addDrive(drive);
    this.robot = svg("g", { class: "robot" }, this.overlay);
    svg("circle", { r: 13 }, this.robot);
    svg("path", { d: "M0-9 6 7 0 3.5-6 7Z" }, this.robot);
    this.robot.style.display = "none";
    await Promise.all(site.layers.map(prepareLayer));
  }

  addPlan(plan) {
    const d = "M" + plan.path.map((point) => point.join(" ")).join("L");
    const group = svg("g", { class: "plan" }, this.lines);
    if (plan.colour) group.style.setProperty("--line", plan.colour);
    svg("path", { d, class: "edge" }, group);
    svg("path", { d, class: "line" }, group);
    const marks = svg("g", { class: "plan" }, this.marks);
    if (plan.colour) marks.style.setProperty("--line", plan.colour);
    const last = plan.waypoints.length - 1;
    plan.parts = [group, marks];
    for (const point of plan.waypoints) {
      const role = point.index === 0 ? "start" : point.index === last ? "end" : "waypoint";
      const shape = role === "end" ? ["rect", { x: -6, y: -6, width: 12, height: 12 }] : ["circle", { r: role === "start" ? 6 : 3.5 }];
      const mark = svg(shape[0], { ...shape[1], class: role, "data-waypoint": point.index }, marks);
      const told = [`${plan.name}: waypoint ${point.index + 1}${role === "waypoint" ? "" : `, ${role}`}`, ...point.told];
      if (point.x !== null) told[told.length - 1] += ` (${plan.crs})`;
      this.hits.push({ e: point.e, n: point.n, mark, told, owner: plan, role });
    }
  }

  addDrive(drive) {
    const group = svg("g", { class: "drive" }, this.lines);
    const breaks = new Set(drive.breaks);
    const d = drive.e.map((e, k) => `${k && !breaks.has(k) ? "L" : "M"}${e} ${drive.n[k]}`).join("");
    svg("path", { d, class: "edge" }, group);
    svg("path", { d, class: "line" }, group);
    drive.driven = svg("path", { class: "driven" }, group);
    const marks = svg("g", { class: "events" }, this.marks);
    drive.parts = [group, marks];
    const shapes = { collision: "M-6-6 6 6M-6 6 6-6", stuck: "M0-7 7 6-7 6Z", intervention: "M-5-5H5V5H-5Z" };
    for (const event of drive.events) {
      const mark = svg("path", { d: shapes[event.kind], class: event.kind }, marks);
      const told = [`${drive.name}: ${event.kind}`, `after ${clock(event.t)}`];
      this.hits.push({ e: event.e, n: event.n, mark, told, owner: drive, role: "event" });
    }
  }

  resize() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.frame;
    if (!width || !height) return;
    [this.width, this.height, this.ratio] = [width, height, ratio];
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.overlay.setAttribute("viewBox", `0 0 ${width} ${height}`);
    this.redraw();
  }

  fit() {
    const [west, south, east, north] = this.site.box;
    const across = Math.max(east - west, 0.1);
    const along = Math.max(north - south, 0.1);
    this.view = { e: (west + east) / 2, n: (south + north) / 2, k: 0.94 * Math.min(this.width / across, this.height / along) };
    this.least = this.view.k / 4;
    this.redraw();
  }

  onScreen(e, n) {
    return [(e - this.view.e) * this.view.k + this.width / 2, this.height / 2 - (n - this.view.n) * this.view.k];
  }

  onGround(x, y) {
    return [this.view.e + (x - this.width / 2) / this.view.k, this.view.n + (this.height / 2 - y) / this.view.k];
  }

  zoom(factor, x = this.width / 2, y = this.height / 2) {
    const [e, n] = this.onGround(x, y);
    const k = Math.min(4000, Math.max(this.least, this.view.k * factor));
    this.view = { e: e - (x - this.width / 2) / k, n: n - (this.height / 2 - y) / k, k };
    this.redraw();
  }

  pan(x, y) {
    this.view.e -= x / this.view.k;
    this.view.n += y / this.view.k;
    this.redraw();
  }

  redraw() {
    if (this.waiting || !this.site) return;
    this.waiting = true;
    requestAnimationFrame(() => {
      this.waiting = false;
      if (this.view && this.width) this.draw();
    });
  }

  draw() {
    const pen = this.canvas.getContext("2d");
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.clearRect(0, 0, this.canvas.width, this.canvas.height);
    for (const layer of this.site.layers) {
      if (!layer.shown) continue;
      pen.globalAlpha = layer.opacity;
      if (layer.type === "area") this.drawArea(pen, layer);
      else if (layer.group === "no_go") this.drawHatched(pen, layer);
      else this.drawPicture(pen, layer);
    }
    pen.globalAlpha = 1;
    const { e, n, k } = this.view;
    const [x, y] = [this.width / 2 - e * k, this.height / 2 + n * k];
    this.lines.setAttribute("transform", `matrix(${k} 0 0 ${-k} ${x} ${y})`);
    for (const part of [...this.site.plans, ...this.site.drives]) {
      for (const element of part.parts) element.style.display = part.shown ? "" : "none";
    }
    for (const plan of this.site.plans) {
      const gap = (plan.length_m * k) / Math.max(1, plan.waypoints.length);
      plan.parts[1].classList.toggle("crowded", gap < CROWDED_PX);
    }
    for (const hit of this.hits) {
      [hit.x, hit.y] = this.onScreen(hit.e, hit.n);
      hit.mark.setAttribute("transform", `translate(${hit.x.toFixed(2)} ${hit.y.toFixed(2)})`);
    }
    this.placeRobot();
    this.drawScale();
  }

  drawPicture(pen, layer) {
    const [a, b, c, d, e, f] = layer.affine;
    const k = this.view.k * this.ratio;
    const [x, y] = this.onScreen(c, f);
    pen.setTransform(k * a, -k * d, k * b, -k * e, x * this.ratio, y * this.ratio);
    const coarse = k * Math.hypot(a, d) > 2;
    pen.imageSmoothingEnabled = layer.type === "image" ? !coarse || k * Math.hypot(a, d) < 6 : false;
    pen.imageSmoothingQuality = "high";
    pen.drawImage(layer.picture, 0, 0, layer.cols, layer.rows);
  }

  /** Draw where a layer is something as hatching, which stands out on any ground. */
  drawHatched(pen, layer) {
    const { width, height } = this.canvas;
    this.stencil = this.stencil || document.createElement("canvas");
    [this.stencil.width, this.stencil.height] = [width, height];
    const inside = this.stencil.getContext("2d");
    const opacity = pen.globalAlpha;
    this.drawPicture(inside, layer);
    inside.setTransform(1, 0, 0, 1, 0, 0);
    inside.globalCompositeOperation = "source-in";
    inside.fillStyle = inside.createPattern(hatching(Math.round(9 * this.ratio), layer.legend[0]?.colour), "repeat");
    inside.fillRect(0, 0, width, height);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.globalAlpha = opacity;
    pen.drawImage(this.stencil, 0, 0);
  }

  drawArea(pen, layer) {
    pen.setTransform(this.ratio, 0, 0, this.ratio, 0, 0);
    pen.beginPath();
    for (const ring of layer.rings) {
      ring.forEach(([e, n], k) => pen[k ? "lineTo" : "moveTo"](...this.onScreen(e, n)));
      pen.closePath();
    }
    pen.lineWidth = 4;
    pen.strokeStyle = "#111";
    pen.stroke();
    pen.lineWidth = 2;
    pen.strokeStyle = "#f0e442";
    pen.setLineDash([8, 5]);
    pen.stroke();
    pen.setLineDash([]);
  }

  drawScale() {
    const bar = this.frame.querySelector(".scale");
    const most = Math.min(180, this.width / 4) / this.view.k;
    const power = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((step) => step * power).find((step) => step <= most) || power;
    bar.style.width = `${length * this.view.k}px`;
    const unit = this.site.north ? "m" : "px";
    bar.textContent = length >= 1000 && unit === "m" ? `${length / 1000} km` : `${+length.toPrecision(2)} ${unit}`;
    this.frame.querySelector(".north").hidden = !this.site.north;
  }

  /** Put the robot where the player says: {e, n, heading} or null. */
  putRobot(pose) {
    this.pose = pose;
    if (this.view && this.width) this.placeRobot();
  }

  placeRobot() {
    this.robot.style.display = this.pose ? "" : "none";
    if (!this.pose) return;
    const [x, y] = this.onScreen(this.pose.e, this.pose.n);
    this.robot.setAttribute("transform", `translate(${x.toFixed(2)} ${y.toFixed(2)}) rotate(${this.pose.heading ?? 0})`);
    this.robot.classList.toggle("unturned", this.pose.heading === null);
  }

  degrees(e, n) {
    const fit = this.site.degrees;
    if (!fit) return null;
    const [u, v] = [(e - fit.middle[0]) / fit.scale, (n - fit.middle[1]) / fit.scale];
    const sum = (weights) => fit.powers.reduce((total, [i, j], k) => total + weights[k] * u ** i * v ** j, 0);
    return [((((sum(fit.lon) + 180) % 360) + 360) % 360) - 180, sum(fit.lat)];
  }

  /** What the layers that are shown say of a place. */
  readings(e, n) {
    const said = [];
    for (const layer of [...this.site.layers].reverse()) {
      if (!layer.shown || layer.type === "area" || !(layer.ids || layer.levels)) continue;
      const [a, b, c, d, ee, f] = layer.affine;
      const det = a * ee - b * d;
      const col = Math.floor((ee * (e - c) - b * (n - f)) / det);
      const row = Math.floor((a * (n - f) - d * (e - c)) / det);
      if (col < 0 || row < 0 || col >= layer.cols || row >= layer.rows) continue;
      const at = row * layer.cols + col;
      if (layer.ids) {
        const entry = layer.legend.find((each) => each.id === layer.ids[at]);
        if (entry) said.push(entry.label);
      } else if (layer.levels[at] > 0) {
        const value = layer.low + ((layer.levels[at] - 1) / 65534) * (layer.high - layer.low);
        said.push(`${layer.label} ${value.toPrecision(4)}`);
      }
    }
    return said;
  }

  listen() {
    const at = (event) => {
      const box = this.frame.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.frame.addEventListener("pointerdown", (event) => {
      if (event.target.closest("button")) return;
      this.frame.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, at(event));
    });
    this.frame.addEventListener("pointermove", (event) => {
      if (!this.view) return;
      const now = at(event);
      const before = this.pointers.get(event.pointerId);
      if (before) {
        const other = [...this.pointers].find(([id]) => id !== event.pointerId);
        if (other) {
          const apart = (point) => Math.hypot(point[0] - other[1][0], point[1] - other[1][1]);
          this.zoom(apart(now) / Math.max(1, apart(before)), (now[0] + other[1][0]) / 2, (now[1] + other[1][1]) / 2);
          this.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
        } else this.pan(now[0] - before[0], now[1] - before[1]);
        this.pointers.set(event.pointerId, now);
      }
      this.point(...now);
    });
    for (const kind of ["pointerup", "pointercancel"]) {
      this.frame.addEventListener(kind, (event) => {
        this.pointers.delete(event.pointerId);
        if (this.view) this.point(...at(event));
      });
    }
    this.frame.addEventListener("pointerleave", () => this.unpoint());
    this.frame.addEventListener("dblclick", (event) => this.zoom(2, ...at(event)));
    this.frame.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(-event.deltaY * (event.deltaMode ? 0.05 : 0.0016)), ...at(event));
      },
      { passive: false },
    );
    this.frame.addEventListener("keydown", (event) => this.key(event));
  }

  key(event) {
    const step = 60;
    const keys = {
      ArrowLeft: () => this.pan(step, 0),
      ArrowRight: () => this.pan(-step, 0),
      ArrowUp: () => this.pan(0, step),
      ArrowDown: () => this.pan(0, -step),
      "+": () => this.zoom(1.3),
      "=": () => this.zoom(1.3),
      "-": () => this.zoom(1 / 1.3),
      0: () => this.fit(),
    };
    if (event.ctrlKey || event.metaKey || !keys[event.key]) return;
    event.preventDefault();
    keys[event.key]();
  }

  point(x, y) {
    const [e, n] = this.onGround(x, y);
    const place = this.degrees(e, n);
    const where = place ? `${place[1].toFixed(7)}, ${place[0].toFixed(7)}` : `${e.toFixed(2)} across, ${(-n).toFixed(2)} down`;
    this.frame.querySelector(".place").textContent = [where, ...this.readings(e, n)].join("  ·  ");
    const near = this.hits.filter((hit) => hit.owner.shown && Math.hypot(hit.x - x, hit.y - y) <= HOVER_PX);
    near.sort((one, other) => Math.hypot(one.x - x, one.y - y) - Math.hypot(other.x - x, other.y - y));
    this.showTip(near[0]);
  }

  showTip(hit) {
    this.marks.querySelector(".pointed")?.classList.remove("pointed");
    this.tip.hidden = !hit;
    if (!hit) return;
    hit.mark.classList.add("pointed");
    this.tip.replaceChildren(
      ...hit.told.map((line) => {
        const row = document.createElement("div");
        row.textContent = line;
        return row;
      }),
    );
    const { offsetWidth: width, offsetHeight: height } = this.tip;
    const x = hit.x + 16 + width > this.width ? hit.x - 16 - width : hit.x + 16;
    this.tip.style.left = `${Math.max(4, x)}px`;
    this.tip.style.top = `${Math.min(this.height - height - 4, Math.max(4, hit.y - height / 2))}px`;
  }

  unpoint() {
    this.frame.querySelector(".place").textContent = "";
    this.showTip(null);
  }

  /** Show a waypoint of a plan as if it were pointed at, moving the map there if it lies outside. */
  reveal(plan, index) {
    const hit = this.hits.find((each) => each.owner === plan && each.mark.dataset.waypoint === String(index));
    if (!hit) return;
    if (hit.x < 20 || hit.y < 20 || hit.x > this.width - 20 || hit.y > this.height - 20) {
      [this.view.e, this.view.n] = [hit.e, hit.n];
      this.draw();
    }
    this.showTip(hit);
  }
}

function hatching(side, colour = "#5a5a5a") {
  const tile = document.createElement("canvas");
  tile.width = tile.height = side;
  const pen = tile.getContext("2d");
  pen.fillStyle = colour;
  pen.globalAlpha = 0.75;
  pen.fillRect(0, 0, side, side);
  pen.globalAlpha = 1;
  pen.strokeStyle = "#ffffff";
  pen.lineWidth = side / 6;
  for (const shift of [-side, 0, side]) {
    pen.beginPath();
    pen.moveTo(shift, side);
    pen.lineTo(shift + side, 0);
    pen.stroke();
  }
  return tile;
}

function clock(seconds) {
  const whole = Math.round(seconds);
  const [hours, minutes, rest] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  const two = (number) => String(number).padStart(2, "0");
  return hours ? `${hours}:${two(minutes)}:${two(rest)}` : `${minutes}:${two(rest)}`;
}
