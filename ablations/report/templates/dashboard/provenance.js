// Where a number comes from: a dialog over the page.
function openDialog(title, ...content) {
  const dialog = document.getElementById("provenance");
  const close = element("button", { type: "button", class: "close", onclick: () => dialog.close() }, "Close");
  dialog.replaceChildren(element("header", {}, element("h2", { id: "provenance-title" }, title), close), ...content);
  for (const anchor of dialog.querySelectorAll("a")) anchor.addEventListener("click", () => dialog.close());
  if (!dialog.open) dialog.showModal();
}

function facts(pairs) {
  const lines = pairs.filter(([, value]) => value !== undefined && value !== null && value !== "");
  return element("dl", {}, lines.map(([name, value]) =>
    element("div", {}, element("dt", {}, name), element("dd", {}, value))));
}

function distinct(indices, read) {
  const found = new Map();
  for (const index of indices) {
    const value = read(index);
    found.set(value, (found.get(value) ?? 0) + 1);
  }
  return [...found].map(([value, count]) => (found.size > 1 ? `${value} (${count})` : `${value}`)).join("\n");
}

const seedOf = (index) => (records.seed[index] === null ? "none" : String(records.seed[index]));

function times(indices) {
  const sorted = indices.map((index) => field(index, "time")).sort();
  return sorted.length > 1 && sorted[0] !== sorted.at(-1) ? `${sorted[0]} to ${sorted.at(-1)}` : sorted[0];
}

// The runs behind records, each with a link to its settings.
function sourceLinks(indices) {
  const found = new Map();
  for (const index of indices) for (const [job, name] of field(index, "sources")) found.set(`${job}/${name}`, [job, name]);
  if (!found.size) return "the records name none";
  const links = [...found.values()].map(([job, name]) => element("li", {}, link(`${job}/${name}`, ...settingsAddress(job, name))));
  return element("ul", {}, links);
}

// Of a cell: a line of a table in one metric.
function showCell(table, line, place) {
  const metric = metricOf.get(table.metrics[place]);
  const number = line.numbers[place];
  const row = table.rows[line.row];
  const own = line.records.filter((i) => field(table.records[i], "kind") !== "missing");
  const indices = own.map((i) => table.records[i]);
  const overrides = [...(row.train ?? []).map((text) => `train: ${text}`), ...(row.enhance ?? []).map((text) => `enhance: ${text}`)];
  const where = { table: table.name, row: line.row, block: line.block, dataset: line.dataset };
  const counted = `${plural(number.views ?? 0, "view")}, ${plural(number.scenes ?? 0, "scene")}, ` +
    (number.seeds ? plural(number.seeds, "seed") : "nothing trained");
  openDialog(
    `${row.title} · ${line.block} · ${datasetTitle(table, line.dataset)} · ${labelOf(metric)}${line.statistic ? ` · ${line.statistic}` : ""}`,
    facts([
      ["Value", finite(number.value) ? `${number.value}` : line.statistic ? "" : "missing"],
      ["Gain", finite(number.gain) ? `${number.gain} over ${rowTitle(table, table.baseline)}` : ""],
      ["Interval", finite(number.low) ? `${number.low} to ${number.high} (95%, bootstrap over scenes, or over the views of few scenes)` : ""],
      ["Spread", finite(number.deviation) ? `${number.deviation} (standard deviation over seeds)` : ""],
      ["Paper", finite(number.paper) || finite(number.paper_gain) ? `${[number.paper, finite(number.paper_gain) ? `gain ${written(metric, number.paper_gain, true)}` : ""].filter((x) => x !== undefined && x !== "").join(", ")}` : ""],
      ["n", counted],
      ["Missing", (number.reasons ?? []).join("\n")],
      ["Row", row.about],
      ["Config", row.weights ? `weights ${row.weights}` : overrides.join("\n") || "nothing changed"],
      ["Seed", indices.length ? distinct(indices, seedOf) : ""],
      ["Commit", indices.length ? distinct(indices, (i) => field(i, "commit")) : ""],
      ["Machine", indices.length ? distinct(indices, (i) => field(i, "machine")) : ""],
      ["Time", times(indices)],
      ["Protocol", indices.length ? distinct(indices, (i) => field(i, "protocol")) : ""],
      ["Runs", indices.length ? sourceLinks(indices) : ""],
      ["File", table.digest ? `${table.name}.jsonl, SHA-256 ${table.digest}` : table.absent],
    ]),
    element("p", {}, link(`All ${plural(indices.length, "record")} of this cell`, "measurements", where)),
    recordList(table, own.slice(0, 60), metric, own.length),
  );
}

function recordList(table, places, metric, total) {
  if (!places.length) return null;
  const at = (i) => table.records[i];
  const columns = [
    { label: "scene", value: (i) => field(at(i), "scene"), cell: (i) => field(at(i), "scene") },
    { label: "view", value: (i) => field(at(i), "view"), cell: (i) => field(at(i), "view") || "–" },
    { label: "seed", value: (i) => records.seed[at(i)], cell: (i) => seedOf(at(i)) },
    { label: metric.label, value: (i) => numeric(valueOf(at(i), metric.key)), cell: (i) => written(metric, valueOf(at(i), metric.key)) },
    { label: "gain", value: (i) => gainOf(table, i, metric.key), cell: (i) => written(metric, gainOf(table, i, metric.key), true) },
    { label: "checksum", value: (i) => records.checksum[at(i)], cell: (i) => element("code", {}, records.checksum[at(i)]) },
  ];
  const caption = total > places.length ? `The first ${places.length} of ${total} records` : "Its records";
  return grid({ columns, rows: places, caption });
}

// Of one record: everything that it says.
function showRecord(index) {
  const values = data.metrics.filter((metric) => valueOf(index, metric.key) !== null)
    .map((metric) => [labelOf(metric), String(valueOf(index, metric.key))]);
  const reasons = field(index, "reasons").map(([name, reason]) => [`No ${name}`, reason]);
  const [width, height] = field(index, "size");
  openDialog(
    [field(index, "scene"), field(index, "splat"), field(index, "variant"), field(index, "view")].filter(Boolean).join(" · "),
    facts([
      ...values, ...reasons,
      ["Kind", field(index, "kind")], ["Seed", seedOf(index)], ["Size", width ? `${width}×${height}` : ""],
      ["Run", field(index, "run")], ["Commit", field(index, "commit")], ["Machine", field(index, "machine")],
      ["Time", field(index, "time")], ["Protocol", field(index, "protocol")], ["Runs", sourceLinks([index])],
      ["Checksum", records.checksum[index]],
    ]),
  );
}
