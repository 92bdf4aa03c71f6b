// What the trainings logged, one quantity at a time.
const PALETTE = ["#4a7dff", "#e0602a", "#1f9d68", "#a06bff", "#d8458a", "#1690b8", "#a08a00", "#808896"]; // legible on light and dark

function drawCurves(panel, query) {
  const trained = data.runs.filter((run) => Object.keys(run.curves).length);
  const absent = data.runs.filter((run) => run.absent.curves);
  const names = [...new Set(trained.flatMap((run) => Object.keys(run.curves)))].sort(collator.compare);
  const name = names.includes(query.get("quantity")) ? query.get("quantity") : names.find((text) => text.startsWith("gain/")) ?? names[0];
  panel.replaceChildren();
  if (!names.length) panel.append(note(absent.length ? "No training that the records name has a log here." : "The records name no training."));
  else {
    panel.append(choice("Quantity", names.map((text) => [text, text]), name, (value) => go("curves", { quantity: value })));
    panel.append(curveChart(name, trained.filter((run) => run.curves[name])));
    const without = trained.filter((run) => !run.curves[name]);
    if (without.length) panel.append(note(`Not logged by ${without.map((run) => run.name).join(", ")}.`));
  }
  if (absent.length) panel.append(missingList("Trainings without a log", absent.map((run) => [run.name, run.absent.curves])));
}

function missingList(title, pairs) {
  return element("details", { open: pairs.length <= 8 }, element("summary", {}, `${title} (${pairs.length})`),
    element("ul", {}, pairs.map(([name, reason]) => element("li", {}, `${name}: ${reason}`))));
}

function curveChart(name, runs) {
  const [width, height, left, bottom] = [900, 360, 64, 36];
  const points = runs.map((run) => run.curves[name]);
  const [lowX, highX] = range(points.flatMap((curve) => [curve.x[0], curve.x.at(-1)]));
  const [lowY, highY] = range(points.flatMap((curve) => extremes(curve.y)));
  const x = (value) => left + ((width - left - 12) * (value - lowX)) / (highX - lowX);
  const y = (value) => height - bottom - ((height - bottom - 12) * (value - lowY)) / (highY - lowY);
  const picture = shape("svg", { viewBox: `0 0 ${width} ${height}`, class: "chart", role: "img", "aria-label": `${name} over optimiser steps, ${plural(runs.length, "run")}` });
  for (const tick of ticks(lowX, highX)) picture.append(
    shape("line", { x1: x(tick.value), x2: x(tick.value), y1: 12, y2: height - bottom, class: "rule" }),
    shape("text", { x: x(tick.value), y: height - bottom + 16, "text-anchor": "middle" }, tick.text));
  for (const tick of ticks(lowY, highY)) picture.append(
    shape("line", { x1: left, x2: width - 12, y1: y(tick.value), y2: y(tick.value), class: "rule" }),
    shape("text", { x: left - 6, y: y(tick.value) + 4, "text-anchor": "end" }, tick.text));
  picture.append(shape("text", { x: (width + left) / 2, y: height - 4, "text-anchor": "middle" }, "optimiser step"));
  runs.forEach((run, index) => {
    const curve = run.curves[name];
    const path = curve.x.map((step, i) => `${i ? "L" : "M"}${x(step).toFixed(1)} ${y(curve.y[i]).toFixed(1)}`).join("");
    const colour = PALETTE[index % PALETTE.length];
    const line = curve.x.length > 1 ? shape("path", { d: path, class: "curve", stroke: colour, "stroke-dasharray": index < PALETTE.length ? undefined : "6 3", "data-run": run.name })
      : shape("circle", { cx: x(curve.x[0]), cy: y(curve.y[0]), r: 3, fill: colour, "data-run": run.name });
    line.append(shape("title", {}, run.name));
    picture.append(line);
  });
  const legend = element("ul", { class: "key" }, runs.map((run, index) => keyEntry(picture, run, name, PALETTE[index % PALETTE.length])));
  return element("figure", {}, picture, legend);
}

function keyEntry(picture, run, name, colour) {
  const curve = run.curves[name];
  const last = curve.y.at(-1);
  const thinned = curve.logged > curve.x.length ? `, ${curve.x.length} of ${curve.logged} points drawn` : "";
  const toggle = element("input", { type: "checkbox", checked: true, onchange: () => {
    for (const line of picture.querySelectorAll("[data-run]")) if (line.dataset.run === run.name) line.toggleAttribute("hidden", !toggle.checked);
  } });
  const swatch = element("i");
  swatch.style.background = colour;
  return element("li", {}, element("label", {}, toggle, swatch, `${run.name}: ${Number(last.toPrecision(5))} at step ${curve.x.at(-1)}${thinned}`));
}

function extremes(values) {
  let [low, high] = [Infinity, -Infinity];
  for (const value of values) { low = Math.min(low, value); high = Math.max(high, value); }
  return [low, high];
}

// Low and high with a little room; never an empty range.
function range(values) {
  const [low, high] = extremes(values);
  const room = (high - low || Math.abs(high) || 1) * 0.04;
  return [low - room, high + room];
}
