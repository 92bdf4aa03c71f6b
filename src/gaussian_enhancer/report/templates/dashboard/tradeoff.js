// Diagrams of error over run time; opened on its own, a diagram tells every mark's name and numbers.
function drawTradeoff(panel) {
  panel.replaceChildren();
  if (!data.diagrams.length) {
    panel.append(note("No diagram: gaussian-enhancer tradeoff has not written any where this page was made."));
    return;
  }
  panel.append(note("Error over run time, both logarithmic; the grey staircase is the Pareto front. Open a diagram to read its marks."));
  for (const { title, file } of data.diagrams) {
    const picture = element("img", { src: file, alt: title, loading: "lazy", class: "diagram" });
    panel.append(element("figure", {}, element("figcaption", {}, title), element("a", { href: file }, picture)));
  }
}
