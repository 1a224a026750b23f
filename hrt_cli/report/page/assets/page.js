// The page: puts map, layers, player, charts and tables together.

const GROUPS = {
  areas: "areas",
  no_go: "no-go",
  sd: "standard deviation",
  score: "score",
  heat: "heat",
  measured: "measured",
  classes: "classes",
  truth: "truth",
  heights: "heights",
  orthomosaic: "orthomosaic",
};

function legendOf(layer) {
  if (layer.type === "ids" && layer.legend.length) {
    const entries = layer.legend.map((entry) => {
      const swatch = html("i");
      swatch.style.background = entry.colour;
      return html("li", {}, swatch, ` ${entry.label} `, html("b", {}, `${(100 * entry.share).toFixed(entry.share < 0.1 ? 1 : 0)} %`));
    });
    return html("ul", { className: "legend" }, ...entries);
  }
  if (layer.type !== "values") return null;
  const bar = html("div", { className: "ramp" });
  bar.style.background = `linear-gradient(90deg, ${layer.ramp.map(([at, colour]) => `${colour} ${100 * at}%`).join(", ")})`;
  const ends = html("div", { className: "ends" }, html("span", {}, told(layer.low)), html("span", {}, layer.label), html("span", {}, told(layer.high)));
  return html("div", {}, bar, ends);
}

function entryOf(part, label, map, kind) {
  const box = html("input", { type: "checkbox", checked: part.shown });
  const swatch = html("i", { className: `swatch ${kind}` });
  if (part.colour) swatch.style.setProperty("--line", part.colour);
  const entry = html("div", { className: "entry" }, html("label", {}, box, swatch, html("span", {}, label)));
  const more = html("div", { className: "more", hidden: !part.shown });
  if ("opacity" in part && part.type !== "area") {
    const slider = html("input", { type: "range", min: 0, max: 1, step: 0.05, value: part.opacity, title: "opacity" });
    slider.setAttribute("aria-label", `opacity of ${label}`);
    slider.addEventListener("input", () => {
      part.opacity = +slider.value;
      map.redraw();
    });
    more.append(slider);
    const legend = legendOf(part);
    if (legend) more.append(legend);
  }
  box.addEventListener("change", () => {
    part.shown = box.checked;
    more.hidden = !box.checked;
    map.redraw();
  });
  entry.append(more);
  part.box = box;
  return entry;
}

function fillPanel(panel, site, map) {
  panel.replaceChildren();
  const section = (title, entries) => {
    if (!entries.length) return;
    const inside = html("div", {}, ...entries);
    const whole = html("details", { open: true }, html("summary", {}, title), inside);
    panel.append(whole);
  };
  section("plans", site.plans.map((plan) => entryOf(plan, plan.name, map, "plan")));
  section("drives", site.drives.map((drive) => entryOf(drive, drive.name, map, "drive")));
  for (const [group, title] of Object.entries(GROUPS)) {
    const layers = site.layers.filter((layer) => layer.group === group);
    section(title, layers.map((layer) => entryOf(layer, layer.title, map, "layer")));
  }
}

function fillWaypoints(place, site, map) {
  const tables = site.plans.map((plan) => {
    const whole = html("details", {}, html("summary", {}, `${plan.name}: ${plan.waypoints.length} waypoints, ${plan.length_m.toFixed(0)} m`));
    whole.addEventListener("toggle", () => {
      if (whole.open && !whole.querySelector("table")) whole.append(waypointTable(plan, map));
    });
    return whole;
  });
  place.replaceChildren(...tables);
  place.closest("section").hidden = !tables.length;
}

function chooseTheme() {
  const root = document.documentElement;
  const dark = () => (root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches);
  document.querySelector("#theme").addEventListener("click", () => {
    root.dataset.theme = dark() ? "light" : "dark";
  });
}

async function main() {
  const data = JSON.parse(document.querySelector("#data").textContent);
  const root = document.documentElement;
  chooseTheme();
  const charts = document.querySelector("#charts");
  charts.append(...data.charts.map(showChart));
  charts.closest("section").hidden = !data.charts.length;
  for (const button of document.querySelectorAll(".pictures button")) {
    button.addEventListener("click", () => button.parentElement.classList.toggle("large"));
  }
  const whole = document.querySelector("#map");
  if (!data.sites.length) {
    whole.hidden = true;
    root.dataset.ready = "yes";
    return;
  }
  const map = new SiteMap(whole.querySelector(".frame"));
  const player = new Player(document.querySelector("#player"), map);
  const show = async (site) => {
    await map.show(site);
    fillPanel(whole.querySelector(".panel"), site, map);
    fillWaypoints(document.querySelector("#waypoints"), site, map);
    whole.querySelector(".about").textContent = site.note;
    player.show(site.drives);
    map.resize(); // the player may have taken some of its room
    map.fit();
    map.draw();
    root.dataset.ready = "yes";
  };
  const choice = whole.querySelector(".site");
  choice.append(...data.sites.map((site, index) => new Option(site.name, index)));
  choice.parentElement.hidden = data.sites.length < 2;
  choice.addEventListener("change", () => show(data.sites[choice.value]));
  for (const [button, act] of [[".in", () => map.zoom(1.5)], [".out", () => map.zoom(1 / 1.5)], [".fit", () => map.fit()]]) {
    whole.querySelector(button).addEventListener("click", act);
  }
  const full = whole.querySelector(".full");
  full.hidden = !document.fullscreenEnabled;
  full.addEventListener("click", () => (document.fullscreenElement ? document.exitFullscreen() : whole.requestFullscreen()));
  document.addEventListener("keydown", (event) => {
    const busy = event.target.closest("input, select, button, summary, a");
    if (event.key === " " && !busy && !player.section.hidden) {
      event.preventDefault();
      player.toggle();
    }
  });
  await show(data.sites[0]);
}

if (!("DecompressionStream" in window)) {
  document.querySelector("#old").hidden = false;
} else {
  main().catch((error) => {
    const place = document.querySelector("#old");
    place.textContent = `This page is damaged: ${error.message}`;
    place.hidden = false;
    throw error;
  });
}
