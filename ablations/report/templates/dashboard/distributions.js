// Gains of single views, by row and scene: every view a dot, quartiles as a box.
function drawDistributions(panel, query) {
  panel.replaceChildren();
  const tables = data.tables.filter((table) => table.baseline_of.some((before) => before.length));
  if (!tables.length) { panel.append(note("No view was measured under a baseline and another row.")); return; }
  const table = tables.find((one) => one.name === query.get("table")) ?? tables[0];
  const key = table.metrics.includes(query.get("metric")) ? query.get("metric") : table.metrics[0];
  const now = { table: table.name, metric: key };
  panel.append(element("div", { class: "choices" },
    choice("Table", tables.map((one) => [one.name, one.title]), table.name, (value) => go("distributions", { ...now, table: value })),
    choice("Metric", table.metrics.map((name) => [name, labelOf(metricOf.get(name))]), key, (value) => go("distributions", { ...now, metric: value }))));
  const metric = metricOf.get(key);
  const strips = gainStrips(table, key);
  const reach = extremes(strips.flatMap((strip) => extremes(strip.gains)));
  if (!strips.length) panel.append(note("No gain is known in this metric."));
  for (const row of Object.keys(table.rows)) {
    const own = strips.filter((strip) => strip.row === row);
    if (own.length) panel.append(stripChart(table, metric, row, own, reach));
  }
}

function gainStrips(table, key) {
  const found = new Map();
  table.records.forEach((index, place) => {
    const gain = gainOf(table, place, key);
    if (!Number.isFinite(gain)) return;
    const [row, scene, splat] = [field(index, "variant"), field(index, "scene"), field(index, "splat")];
    const name = JSON.stringify([row, scene, splat]);
    if (!found.has(name)) found.set(name, { row, scene, splat, gains: [] });
    found.get(name).gains.push(gain);
  });
  return [...found.values()];
}

function quantile(sorted, share) {
  const place = share * (sorted.length - 1);
  const low = Math.floor(place);
  return sorted[low] + (place - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
}

function stripChart(table, metric, row, strips, reach) {
  const [width, left, right, step] = [900, 200, 250, 26];
  const [low, high] = range([...reach, 0]);
  const height = strips.length * step + 44;
  const x = (value) => left + ((width - left - right) * (value - low)) / (high - low);
  const title = `${rowTitle(table, row)}: gain in ${labelOf(metric)}`;
  const picture = shape("svg", { viewBox: `0 0 ${width} ${height}`, class: "chart", role: "group", "aria-label": title });
  for (const tick of ticks(low, high)) picture.append(
    shape("line", { x1: x(tick.value), x2: x(tick.value), y1: 4, y2: height - 36, class: tick.value === 0 ? "rule zero" : "rule" }),
    shape("text", { x: x(tick.value), y: height - 20, "text-anchor": "middle" }, tick.text));
  strips.forEach((strip, index) => picture.append(...oneStrip(table, metric, strip, 16 + index * step, { x, left, width, right })));
  return element("figure", {}, element("figcaption", {}, title), picture);
}

function oneStrip(table, metric, strip, y, { x, left, width, right }) {
  const sorted = Float64Array.from(strip.gains).sort();
  const [quarter, median, three] = [0.25, 0.5, 0.75].map((share) => quantile(sorted, share));
  const dots = strip.gains.map((gain, i) => `M${x(gain).toFixed(1)} ${(y + 3 * Math.sin(12.9898 * i)).toFixed(1)}h0`).join("");
  const where = { table: table.name, row: strip.row, scene: strip.scene, block: strip.splat };
  const summary = `${written(metric, median, true)} [${written(metric, quarter, true)}, ${written(metric, three, true)}] n ${strip.gains.length}`;
  const label = shape("a", { href: address("measurements", where) }, shape("text", { x: left - 8, y: y + 4, "text-anchor": "end" }, shortened(`${strip.scene} ${strip.splat}`)));
  return [
    label,
    shape("rect", { x: x(quarter), y: y - 7, width: Math.max(1, x(three) - x(quarter)), height: 14, class: "box" }),
    shape("path", { d: dots, class: "dots" }, shape("title", {}, summary)),
    shape("line", { x1: x(median), x2: x(median), y1: y - 8, y2: y + 8, class: "median", "data-median": median, "data-n": strip.gains.length }),
    shape("text", { x: width - right + 10, y: y + 4 }, summary),
  ];
}

const shortened = (text) => (text.length > 28 ? `${text.slice(0, 27)}…` : text);
