// Diagrams and tables of a study; opened on its own, a diagram tells every mark's name and numbers.
const drawStudy = (name) => (panel) => {
  const study = data.studies.find((one) => one.name === name);
  panel.replaceChildren();
  if (!study || study.absent) {
    panel.append(note(study?.absent || "Nothing was measured where this page was made."));
    return;
  }
  panel.append(note(study.note));
  for (const { title, columns, rows } of study.tables) {
    const heads = columns.map((label, place) => ({ label, word: place === 0, value: (row) => sortable(row[place]), cell: (row) => row[place] }));
    panel.append(element("section", { class: "part" }, element("h2", {}, title), grid({ columns: heads, rows, caption: plural(rows.length, "line") })));
  }
  for (const { title, file } of study.diagrams) {
    const picture = element("img", { src: file, alt: title, loading: "lazy", class: "diagram" });
    panel.append(element("figure", {}, element("figcaption", {}, title), element("a", { href: file }, picture)));
  }
};

// A cell that is written as a number sorts as one.
function sortable(text) {
  const number = Number(text.replace(/[%*]/g, "").split(" ")[0]);
  return text !== "" && Number.isFinite(number) ? number : text;
}
