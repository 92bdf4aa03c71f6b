// Every record, to be filtered and sorted.
function drawMeasurements(panel, query) {
  const asked = Object.fromEntries(["table", "row", "block", "dataset", "scene"].map((name) => [name, query.get(name) ?? ""]));
  const list = element("div");
  const text = element("input", { type: "search", value: query.get("text") ?? "", placeholder: "scene, view, row, run, commit …", onchange: () => show() });
  const tables = [["", "all tables"], ...data.tables.map((table) => [table.name, table.title])];
  const told = ["row", "block", "dataset", "scene"].filter((name) => asked[name]).map((name) => `${name} ${asked[name]}`);
  panel.replaceChildren(element("div", { class: "choices" },
    choice("Table", tables, asked.table, (value) => go("measurements", value ? { table: value } : {})),
    element("label", { class: "choice" }, element("span", {}, "Filter"), text)));
  if (told.length) panel.append(element("p", { class: "note" }, `Only ${told.join(", ")}. `, link("Show all", "measurements", asked.table ? { table: asked.table } : {})));
  panel.append(list);

  function show() {
    const words = text.value.toLowerCase().split(/\s+/).filter(Boolean);
    const chosen = selected(asked).filter((index) => !words.length || matches(index, words));
    list.replaceChildren(recordGrid(chosen));
  }
  show();
}

function selected(asked) {
  const table = tableOf.get(asked.table);
  if (!table) return records.checksum.map((_, index) => index);
  const scenes = table.datasets[asked.dataset]?.scenes;
  const kept = (index, place) =>
    (!asked.row || field(index, "variant") === asked.row) && (!asked.scene || field(index, "scene") === asked.scene) &&
    (!asked.block || table.blocks[table.block_of[place]] === asked.block || field(index, "splat") === asked.block) &&
    (!scenes || scenes.includes(field(index, "scene")));
  return table.records.filter(kept);
}

function matches(index, words) {
  const names = ["kind", "run", "scene", "splat", "view", "variant", "commit", "machine"];
  const text = [...names.map((name) => field(index, name)), records.checksum[index], ...field(index, "sources").flat()].join("\n").toLowerCase();
  return words.every((word) => text.includes(word));
}

function recordGrid(indices) {
  const plain = (label, read) => ({ label, word: true, value: read, cell: (index) => element("td", { class: "word" }, read(index) || "–") });
  const columns = [
    { label: "scene", value: (index) => field(index, "scene"), cell: (index) => element("button", { type: "button", class: "cell", onclick: () => showRecord(index) }, field(index, "scene")) },
    plain("splat", (index) => field(index, "splat")), plain("row", (index) => field(index, "variant")), plain("view", (index) => field(index, "view")),
    { label: "seed", value: (index) => records.seed[index], cell: (index) => seedOf(index) },
    ...data.metrics.map((metric) => ({ label: labelOf(metric), meaning: metric.meaning, value: (index) => numeric(valueOf(index, metric.key)), cell: (index) => measuredCell(index, metric) })),
  ];
  return grid({ columns, rows: indices, caption: plural(indices.length, "record"), describe: (index) => ({ "data-record": records.checksum[index] }) });
}

function measuredCell(index, metric) {
  const value = valueOf(index, metric.key);
  const reason = reasonsOf(index)[metric.key] ?? reasonsOf(index).row;
  if (value !== null) return element("td", { "data-metric": metric.key, "data-value": value }, written(metric, value));
  return element("td", { class: "quiet", title: reason }, reason ? "missing" : "–");
}
