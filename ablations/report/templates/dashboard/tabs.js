// Parts of the page: each is drawn when it is first opened, and has an address of its own.
const PARTS = {
  tables: ["Tables", drawTables],
  curves: ["Training curves", drawCurves],
  distributions: ["Distributions", drawDistributions],
  pictures: ["Before / after", drawPictures],
  tradeoff: ["Error / time", drawStudy("tradeoff")],
  stability: ["Stability", drawStudy("stability")],
  plan: ["Left out", drawStudy("plan")],
  settings: ["Configurations", drawSettings],
  measurements: ["Records", drawMeasurements],
};

function go(part, values) {
  location.hash = address(part, values);
  open();
}

function open() {
  const [name, query] = location.hash.slice(1).split("?");
  const part = Object.hasOwn(PARTS, name) ? name : "tables";
  for (const tab of document.querySelectorAll("[role=tab]")) {
    const chosen = tab.dataset.part === part;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    document.getElementById(`part-${tab.dataset.part}`).hidden = !chosen;
  }
  const panel = document.getElementById(`part-${part}`);
  const choices = () => [...panel.querySelectorAll(".choice > :is(select, input)")];
  const focused = choices().indexOf(document.activeElement);
  PARTS[part][1](panel, new URLSearchParams(query ?? ""));
  if (focused >= 0) choices()[focused]?.focus(); // a choice redraws the part that it stands in
  document.documentElement.dataset.drawn = location.hash;
}

function setUp() {
  const list = document.querySelector("[role=tablist]");
  const names = Object.keys(PARTS);
  for (const name of names) {
    list.append(element("button", { type: "button", role: "tab", id: `tab-${name}`, "data-part": name, "aria-controls": `part-${name}`, onclick: () => go(name) }, PARTS[name][0]));
    list.after(element("div", { role: "tabpanel", id: `part-${name}`, "aria-labelledby": `tab-${name}`, hidden: true }));
  }
  list.addEventListener("keydown", (event) => {
    const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    const at = names.indexOf(event.target.dataset.part);
    const next = list.children[(at + step + names.length) % names.length];
    next.focus();
    next.click();
  });
  addEventListener("hashchange", () => { if (document.documentElement.dataset.drawn !== location.hash) open(); });
  open();
}

setUp();
