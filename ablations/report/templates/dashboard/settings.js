// What two runs were told, where they differ.
const runOf = new Map(data.runs.map((run) => [`${run.job}/${run.name}`, run]));
const settingsOf = (run) => new Map(run.settings.map(([key, value]) => [data.keys[key], data.settings[value]]));

function drawSettings(panel, query) {
  panel.replaceChildren();
  const names = [...runOf.keys()];
  if (!names.length) { panel.append(note("The records name no run.")); return; }
  const left = runOf.has(query.get("left")) ? query.get("left") : names[0];
  const job = runOf.get(left).job;
  const fallback = names.find((name) => name !== left && runOf.get(name).job === job) ?? left;
  const right = runOf.has(query.get("right")) ? query.get("right") : fallback;
  if (query.get("left") && !runOf.has(query.get("left"))) panel.append(element("p", { class: "absent" }, `No record names the run ${query.get("left")}.`));
  const options = names.map((name) => [name, name]);
  panel.append(element("div", { class: "choices" },
    choice("Run", options, left, (value) => go("settings", { left: value, right })),
    choice("against", options, right, (value) => go("settings", { left, right: value }))));
  for (const name of new Set([left, right])) {
    const reason = runOf.get(name).absent.settings;
    if (reason) panel.append(element("p", { class: "absent" }, `${name}: no settings, ${reason}.`));
  }
  const [one, two] = [left, right].map((name) => runOf.get(name));
  if (one.absent.settings && two.absent.settings) return;
  panel.append(left === right || one.absent.settings || two.absent.settings ? oneRun(one.absent.settings ? two : one) : difference(one, two));
}

function oneRun(run) {
  const rows = [...settingsOf(run)];
  const columns = [["setting", 0], ["value", 1]].map(([label, place]) => ({ label, word: true, value: (row) => row[place], cell: (row) => (place ? element("td", { class: "word" }, element("code", {}, row[1])) : row[0]) }));
  return grid({ columns, rows, caption: `All ${rows.length} settings of ${run.job}/${run.name}`, page: 1000 });
}

function difference(one, two) {
  const [a, b] = [settingsOf(one), settingsOf(two)];
  const keys = [...new Set([...a.keys(), ...b.keys()])].sort();
  const rows = keys.filter((key) => a.get(key) !== b.get(key)).map((key) => [key, a.get(key), b.get(key)]);
  const told = `${rows.length} of ${plural(keys.length, "setting")} differ`;
  if (!rows.length) return note(`${told}.`);
  const cell = (place) => (row) => element("td", { class: row[place] === undefined ? "word quiet" : "word" }, row[place] === undefined ? "not set" : element("code", {}, row[place]));
  const columns = [
    { label: "setting", value: (row) => row[0], cell: (row) => row[0] },
    { label: `${one.job}/${one.name}`, word: true, value: (row) => row[1], cell: cell(1) },
    { label: `${two.job}/${two.name}`, word: true, value: (row) => row[2], cell: cell(2) },
  ];
  return grid({ columns, rows, caption: told, page: 1000, describe: (row) => ({ "data-setting": row[0] }) });
}
