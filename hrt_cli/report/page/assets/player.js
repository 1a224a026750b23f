// The player: a slider over the time of a drive that moves the robot on the map and shows what its camera saw.

class Player {
  constructor(section, map) {
    this.section = section;
    this.map = map;
    this.slider = section.querySelector("input[type=range]");
    this.button = section.querySelector(".play");
    this.choice = section.querySelector(".drive");
    this.rate = section.querySelector(".rate");
    this.camera = map.frame.querySelector(".camera");
    this.picture = this.camera.querySelector("img");
    this.seen = section.querySelector(".seen");
    this.seen.querySelector("input").addEventListener("change", () => this.showCamera());
    this.slider.addEventListener("input", () => this.seek(+this.slider.value));
    this.button.addEventListener("click", () => this.toggle());
    this.choice.addEventListener("change", () => this.choose(this.drives[this.choice.value]));
  }

  show(drives) {
    this.drives = drives;
    this.section.hidden = !drives.length;
    this.choice.replaceChildren(...drives.map((drive, index) => new Option(drive.name, index)));
    this.choice.hidden = drives.length < 2;
    if (!drives.length) {
      this.camera.hidden = true;
      return this.map.putRobot(null);
    }
    const last = Math.max(0, drives.map((drive) => drive.shown).lastIndexOf(true));
    this.choice.value = last;
    return this.choose(drives[last]);
  }

  choose(drive) {
    this.stop();
    for (const other of this.drives) other.driven.removeAttribute("d");
    this.drive = drive;
    drive.shown = true;
    if (drive.box) drive.box.checked = true;
    this.slider.max = drive.t[drive.t.length - 1];
    this.slider.step = "any";
    this.slider.value = 0;
    this.showCamera();
    this.map.redraw();
    this.seek(0);
  }

  seek(time) {
    const { drive } = this;
    this.time = Math.min(Math.max(time, 0), +this.slider.max);
    let after = drive.t.findIndex((t) => t > this.time);
    if (after < 0) after = drive.t.length;
    const k = Math.max(0, after - 1);
    const next = Math.min(k + 1, drive.t.length - 1);
    const span = drive.t[next] - drive.t[k];
    const jump = drive.breaks.includes(next);
    const part = span > 0 && !jump ? (this.time - drive.t[k]) / span : 0;
    const between = (values) => values[k] + part * (values[next] - values[k]);
    const pose = { e: between(drive.e), n: between(drive.n), heading: this.heading(k, next, part) };
    this.map.putRobot(pose);
    const breaks = new Set(drive.breaks);
    const way = drive.e.slice(0, k + 1).map((e, i) => `${i && !breaks.has(i) ? "L" : "M"}${e} ${drive.n[i]}`);
    drive.driven.setAttribute("d", `${way.join("")}L${pose.e} ${pose.n}`);
    this.slider.value = this.time;
    this.slider.setAttribute("aria-valuetext", clock(this.time));
    this.showFrame();
    this.tell(k);
  }

  showCamera() {
    const { frames, seen } = this.drive;
    this.seen.hidden = !frames.length;
    this.camera.hidden = !frames.length || !this.seen.querySelector("input").checked;
    this.camera.querySelector("figcaption").textContent = seen || "";
  }

  heading(k, next, part) {
    const [from, to] = [this.drive.heading[k], this.drive.heading[next]];
    if (from === null || to === null) return from;
    return from + part * (((((to - from) % 360) + 540) % 360) - 180);
  }

  showFrame() {
    const { frames } = this.drive;
    if (!frames.length) return;
    let at = 0;
    while (at + 1 < frames.length && frames[at + 1].t <= this.time + 1e-6) at += 1;
    if (this.picture.dataset.frame !== `${this.drive.name} ${at}`) {
      this.picture.src = frames[at].src;
      this.picture.dataset.frame = `${this.drive.name} ${at}`;
      this.picture.alt = `what the camera saw after ${clock(frames[at].t)}`;
    }
  }

  tell(k) {
    const { drive } = this;
    const said = [`${clock(this.time)} of ${clock(+this.slider.max)}`];
    if (drive.speed[k] !== null) said.push(`${drive.speed[k].toFixed(2)} m/s`);
    const recent = drive.events.filter((event) => event.t <= this.time && event.t > this.time - 5);
    if (recent.length) said.push(recent[recent.length - 1].kind);
    else if (this.time >= +this.slider.max && drive.end) said.push(drive.end);
    this.section.querySelector(".told").textContent = said.join("  ·  ");
  }

  toggle() {
    if (this.playing) return this.stop();
    if (this.time >= +this.slider.max) this.seek(0);
    this.button.textContent = "❚❚";
    this.button.setAttribute("aria-label", "pause");
    let before = null;
    const step = (now) => {
      if (before !== null) this.seek(this.time + ((now - before) / 1000) * +this.rate.value);
      before = now;
      if (this.time >= +this.slider.max) this.stop();
      else this.playing = requestAnimationFrame(step);
    };
    this.playing = requestAnimationFrame(step);
    return undefined;
  }

  stop() {
    if (this.playing) cancelAnimationFrame(this.playing);
    this.playing = null;
    this.button.textContent = "▶";
    this.button.setAttribute("aria-label", "play");
  }
}
