// The embedded data, and how a record and a number are read.
const data = JSON.parse(document.getElementById("dashboard-data").textContent);
const { records, pools } = data;
const metricOf = new Map(data.metrics.map((metric) => [metric.key, metric]));
const tableOf = new Map(data.tables.map((table) => [table.name, table]));

const finite = (value) => typeof value === "number" && Number.isFinite(value);
const numeric = (value) => (value === "inf" ? Infinity : value === "-inf" ? -Infinity : typeof value === "number" ? value : NaN);
const field = (index, name) => pools[name][records[name][index]];
const valueOf = (index, key) => records.values[key][index];
const labelOf = (metric) => (metric.unit ? `${metric.label}, ${metric.unit}` : metric.label);

function written(metric, value, signed = false) {
  const number = numeric(value);
  if (Number.isNaN(number)) return "–";
  if (!Number.isFinite(number)) return number > 0 ? "∞" : "−∞";
  const zero = Number(number.toFixed(metric.decimals)) === 0;
  if (signed && zero) return `±${(0).toFixed(metric.decimals)}`;
  const text = Math.abs(number).toFixed(metric.decimals);
  return `${number < 0 && !zero ? "−" : signed ? "+" : ""}${text}`;
}

// Which way a gain points, as the digits shown tell it.
function verdict(metric, gain) {
  if (metric.higher === null || !finite(gain) || Number(gain.toFixed(metric.decimals)) === 0) return "same";
  return gain > 0 === metric.higher ? "better" : "worse";
}

// Gain of a table's record (by its place in the table) over the baseline; NaN where it is unknown.
function gainOf(table, place, key) {
  const before = table.baseline_of[place];
  if (!before.length) return NaN;
  const first = before.reduce((sum, index) => sum + numeric(valueOf(index, key)), 0) / before.length;
  return numeric(valueOf(table.records[place], key)) - first;
}

const reasonsOf = (index) => Object.fromEntries(field(index, "reasons"));
const rowTitle = (table, row) => table.rows[row]?.title ?? row;
const datasetTitle = (table, key) => (key === "all" ? "all" : table.datasets[key]?.title ?? key);
const settingsAddress = (job, name) => ["settings", { left: `${job}/${name}` }];
