// Before and after, view by view, with the divider of the report.
function drawPictures(panel, query) {
  panel.replaceChildren();
  const scenes = [...new Set(data.pictures.map((view) => view.scene))];
  const missing = Object.entries(data.pictures_missing);
  if (!scenes.length) panel.append(note("No picture: the enhanced runs that the records name are not on this machine, or the records name none."));
  else {
    const scene = scenes.includes(query.get("scene")) ? query.get("scene") : "";
    panel.append(choice("Scene", [["", `all ${scenes.length}`], ...scenes.map((name) => [name, name])], scene, (value) => go("pictures", value ? { scene: value } : {})));
    const cards = data.pictures.filter((view) => !scene || view.scene === scene).map(pictureCard);
    const grid_ = element("div", { class: "cards" }, cards);
    grid_.style.setProperty("--least", "400px");
    panel.append(grid_);
    for (const stage of grid_.querySelectorAll(".stage")) Stage.setUpStage(stage);
  }
  if (missing.length) panel.append(missingList("Without pictures", missing));
}

function pictureCard(view) {
  const titles = new Map([["render", "render"], ...Object.entries(view.methods), ...(view.files.photo ? [["photo", "photo"]] : [])]);
  const title = `${view.scene} · ${view.splat} · ${view.view}`;
  const rows = Object.keys(view.methods);
  const sides = { raw: ["render", "left"], enhanced: [rows.at(-1), "right"] };
  const input = element("input", { type: "range", min: 0, max: 100, value: 50, step: 1 });
  const images = {}, labels = {};
  const stage = element("div", { class: "stage", "data-mode": "compare" });
  for (const [name, [, side]] of Object.entries(sides)) {
    images[name] = element("img", { class: name, draggable: "false", loading: "lazy" });
    labels[name] = element("span", { class: `label ${side}`, "aria-hidden": "true" });
  }
  stage.append(...Object.values(images), ...Object.values(labels), input, element("span", { class: "divider", "aria-hidden": "true" }));
  stage.style.setProperty("--ratio", (view.size[0] / view.size[1] || 1).toFixed(5));
  const update = () => {
    for (const [name, [what]] of Object.entries(sides)) {
      images[name].setAttribute("src", view.files[what]);
      images[name].setAttribute("alt", `${titles.get(what)}, ${title}`);
      labels[name].textContent = titles.get(what);
    }
    input.setAttribute("aria-label", `Divider between ${titles.get(sides.raw[0])} and ${titles.get(sides.enhanced[0])}, ${title}`);
  };
  update();
  const chooser = (name, label) => choice(label, [...titles], sides[name][0], (value) => { sides[name][0] = value; update(); });
  const enlarge = element("button", { type: "button", class: "enlarge", onclick: () => {
    enlarge.textContent = card.classList.toggle("wide") ? "Reduce" : "Enlarge";
    card.scrollIntoView({ block: "nearest" });
  } }, "Enlarge");
  const card = element("article", { class: "card", "data-scene": view.scene, "data-view": view.view },
    element("header", {}, element("h3", { title }, title), element("span", { class: "meta" }, view.size.join("×"))),
    stage, element("div", { class: "controls" }, chooser("raw", "left"), chooser("enhanced", "right"), enlarge));
  return card;
}
