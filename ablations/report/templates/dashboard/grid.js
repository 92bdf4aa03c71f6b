// A table that sorts by any column and shows long lists page by page.
const PAGE = 200;

function grid({ columns, rows, caption, page = PAGE, describe = () => ({}) }) {
  const state = { order: rows, column: -1, rising: true, first: 0 };
  const body = element("tbody");
  const pager = element("div", { class: "pager" });
  const heads = columns.map((column, index) =>
    element("th", { scope: "col", "aria-sort": "none", title: column.meaning, class: column.word ? "word" : undefined },
      element("button", { type: "button", onclick: () => sortBy(index) }, column.label)));

  function show() {
    const shown = state.order.slice(state.first, state.first + page);
    body.replaceChildren(...shown.map((row) =>
      element("tr", describe(row), ...columns.map((column, index) => {
        const cell = column.cell(row);
        return cell instanceof HTMLTableCellElement ? cell : element(index ? "td" : "th", index ? {} : { scope: "row" }, cell);
      }))));
    const last = Math.min(state.first + page, state.order.length);
    pager.replaceChildren();
    if (rows.length <= page) return;
    const turn = (text, first, off) =>
      element("button", { type: "button", disabled: off, onclick: () => { state.first = first; show(); } }, text);
    pager.append(
      turn("‹ Back", Math.max(0, state.first - page), state.first === 0),
      element("span", { "aria-live": "polite" }, `${state.first + 1}–${last} of ${plural(rows.length, "line")}`),
      turn("On ›", state.first + page, last === state.order.length),
    );
  }

  function sortBy(index) {
    state.rising = state.column === index ? !state.rising : true;
    state.column = index;
    state.first = 0;
    const keyed = rows.map((row) => [columns[index].value(row), row]);
    const sign = state.rising ? 1 : -1;
    keyed.sort(([a], [b]) => {
      const [noA, noB] = [a, b].map((x) => x === undefined || x === null || Number.isNaN(x));
      if (noA || noB) return noA - noB; // what is missing stays last, whichever way
      if (typeof a === "number" && typeof b === "number") return sign * (a - b || 0);
      return sign * collator.compare(String(a), String(b));
    });
    state.order = keyed.map(([, row]) => row);
    heads.forEach((head, i) =>
      head.setAttribute("aria-sort", i === index ? (state.rising ? "ascending" : "descending") : "none"));
    show();
  }

  show();
  const table = element("table", { class: "overview" },
    caption ? element("caption", {}, caption) : null, element("thead", {}, element("tr", {}, heads)), body);
  return element("div", {}, element("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": caption || "Table" }, table), pager);
}

const collator = new Intl.Collator("en", { numeric: true });
