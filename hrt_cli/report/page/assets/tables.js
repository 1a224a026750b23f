// Tables that are long: made when they are opened.

function tableOf([head, ...rows]) {
  const cell = (kind) => (value) => html(kind, {}, value === null || value === undefined ? "" : String(value));
  const body = html("tbody", {}, ...rows.map((row) => html("tr", {}, ...row.map(cell("td")))));
  return html("div", { className: "scroll" }, html("table", {}, html("thead", {}, html("tr", {}, ...head.map(cell("th")))), body));
}

/** The waypoints of a plan; one that is pointed at is shown on the map. */
function waypointTable(plan, map) {
  const rows = plan.waypoints.map((point) => [
    point.index + 1,
    point.lat === null ? "" : point.lat.toFixed(7),
    point.lon === null ? "" : point.lon.toFixed(7),
    point.x.toFixed(2),
    point.y.toFixed(2),
    point.told[0],
  ]);
  const table = tableOf([["", "latitude", "longitude", "x", "y", ""], ...rows]);
  table.querySelectorAll("tbody tr").forEach((row, index) => {
    row.tabIndex = 0;
    for (const kind of ["pointerenter", "focus"]) {
      row.addEventListener(kind, () => map.reveal(plan, plan.waypoints[index].index));
    }
  });
  return table;
}
