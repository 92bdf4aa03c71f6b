// Every table with its lines: value, gain, and the paper's gain beside it.
function drawTables(panel, query) {
  if (!panel.childElementCount) {
    const contents = data.tables.map((table) => element("li", {}, link(table.title, "tables", { table: table.name })));
    panel.append(element("nav", { "aria-label": "Tables" }, element("ol", { class: "contents" }, contents)));
    for (const table of data.tables) panel.append(tableSection(table));
  }
  const wanted = query.get("table");
  if (wanted) document.getElementById(`table-${wanted}`)?.scrollIntoView({ block: "start" });
}

function tableSection(table) {
  const section = element("section", { class: "part", id: `table-${table.name}` },
    element("h2", {}, table.title), element("p", {}, table.about));
  for (const dataset of Object.values(table.datasets)) {
    if (dataset.stand_in) section.append(note(`Stand-in for ${dataset.title}, which is not measured here: ${dataset.stand_in}.`));
  }
  if (table.absent) section.append(element("p", { class: "absent" }, table.absent));
  if (table.outside) section.append(element("p", { class: "absent" }, `${plural(table.outside, "record")} of rows, scenes, splats or seeds that the description does not ask for: in no number here.`));
  section.append(grid({
    columns: lineColumns(table), rows: table.lines, caption: `${table.title}: ${plural(table.records.length, "record")}`,
    describe: (line) => ({ "data-block": line.block, "data-dataset": line.dataset, "data-row": line.row, "data-statistic": line.statistic || undefined }),
  }));
  return section;
}

function lineColumns(table) {
  const columns = [{ label: "row", value: (line) => rowTitle(table, line.row), cell: (line) => rowTitle(table, line.row) }];
  const several = (read) => new Set(table.lines.map(read)).size > 1;
  const add = (label, read) => columns.push({ label, word: true, value: read, cell: (line) => element("td", { class: "word" }, read(line)) });
  if (several((line) => line.block)) add(table.kind === "cost" ? "size" : "splat", (line) => line.block);
  if (Object.keys(table.datasets).length > 1) add("dataset", (line) => datasetTitle(table, line.dataset));
  if (table.kind === "repeats") add("over seeds", (line) => line.statistic);
  table.metrics.forEach((key, place) => columns.push(...metricColumns(table, metricOf.get(key), place)));
  columns.push({ label: "n", meaning: "views / scenes / seeds", value: (line) => counts(line)[0], cell: (line) => element("td", { class: "quiet" }, counts(line).join(" / ")) });
  return columns;
}

// The fewest over the metrics, so that no count promises more than each number has.
function counts(line) {
  const least = (name) => Math.min(...line.numbers.map((number) => number[name] ?? 0));
  return line.numbers.length ? [least("views"), least("scenes"), least("seeds")] : [0, 0, 0];
}

function metricColumns(table, metric, place) {
  const at = (line) => line.numbers[place];
  const column = (label, name, signed, meaning) => ({
    label, meaning, value: (line) => at(line)[name],
    cell: (line) => numberCell(table, line, place, name, signed),
  });
  const paper = (name, signed, label) => ({ ...column(label, name, signed, "as the paper prints it"), cell: (line) =>
    element("td", { class: "paper", "data-metric": metric.key, "data-of": name, "data-value": at(line)[name] }, finite(at(line)[name]) ? paperWritten(metric, at(line)[name], signed) : "–") });
  const value = column(labelOf(metric), "value", false, metric.meaning);
  const gain = column(`Δ ${metric.label}`, "gain", true, "gain over the baseline");
  const papers = paper("paper_gain", true, `Δ ${metric.label}, paper`);
  if (table.kind === "cost") return [value, paper("paper", false, `${metric.label}, paper`)];
  if (table.kind === "repeats") return [gain, papers];
  const has = table.lines.some((line) => finite(at(line).paper_gain));
  return has ? [value, gain, papers] : [value, gain];
}

// Differences of the paper's printed numbers need no more digits than it prints.
function paperWritten(metric, value, signed) {
  return written({ ...metric, decimals: metric.decimals > 2 ? 3 + (Math.abs(value) < 0.0005 ? 1 : 0) : metric.decimals }, value, signed);
}

function numberCell(table, line, place, name, signed) {
  const metric = metricOf.get(table.metrics[place]);
  const number = line.numbers[place];
  const value = number[name];
  const marks = { "data-metric": metric.key, "data-of": name, "data-value": value };
  if (name === "gain" && line.row === table.baseline) return element("td", { class: "quiet", ...marks }, "");
  const lacking = number.reasons ?? [];
  const title = lacking.length ? `missing: ${lacking.join("; ")}` : "where this number comes from";
  const spread = name === "gain" && finite(number.low) ? ` [${written(metric, number.low, true)}, ${written(metric, number.high, true)}]` : "";
  const deviates = line.statistic === "std";
  const text = finite(value) ? written(metric, value, signed && !deviates) : "missing";
  return element("td", { ...marks, class: name === "gain" && !deviates ? verdict(metric, value) : undefined },
    element("button", { type: "button", class: finite(value) ? "cell" : "cell absent", title, onclick: () => showCell(table, line, place) },
      text, spread ? element("small", {}, spread) : null, finite(value) && lacking.length ? element("sup", {}, "*") : null),
    finite(value) ? null : element("div", { class: "reason" }, lacking[0] ?? "no record"));
}
