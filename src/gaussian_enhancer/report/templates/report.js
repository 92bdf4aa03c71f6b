(() => {
  const all = (selector, root = document) => [...root.querySelectorAll(selector)];

  const { moveTo, setUpStage } = Stage;

  function show(card, button) {
    const stage = card.querySelector(".stage");
    const own = card.querySelector(`.controls [data-mode="${button.dataset.mode}"]`);
    if (!own) return; // a view without a photo has nothing but before and after
    stage.dataset.mode = button.dataset.mode;
    stage.querySelector(".left").textContent = button.dataset.left;
    stage.querySelector(".right").textContent = button.dataset.right;
    const input = stage.querySelector("input");
    const name = card.querySelector("h3").textContent;
    input.setAttribute("aria-label", `Divider between ${button.dataset.left} and ${button.dataset.right}, ${name}`);
    moveTo(stage, parseFloat(stage.style.getPropertyValue("--split")));
    press(own);
  }

  function press(button) {
    for (const other of all("button", button.parentElement)) {
      other.setAttribute("aria-pressed", String(other === button));
    }
  }

  function sortBy(button) {
    const head = button.closest("th");
    const table = head.closest("table");
    const column = [...head.parentElement.children].indexOf(head);
    const rising = head.getAttribute("aria-sort") !== "ascending";
    for (const other of all("thead th", table)) other.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", rising ? "ascending" : "descending");
    const value = (row) => row.children[column].dataset.value;
    const order = (a, b) => {
      const [left, right] = [value(a), value(b)];
      if (left === undefined || right === undefined) return (left === undefined) - (right === undefined);
      const [x, y] = [left, right].map((text) => (text === "inf" ? Infinity : text === "-inf" ? -Infinity : Number(text)));
      const names = column === 0 || Number.isNaN(x) || Number.isNaN(y);
      const difference = names ? left.localeCompare(right, "en", { numeric: true }) : x - y;
      return rising ? difference : -difference;
    };
    const rows = all("tbody tr", table).sort(order);
    table.tBodies[0].append(...rows);
    const cards = document.querySelector(".cards");
    cards.append(...rows.map((row) => document.getElementById(`view-${row.dataset.view}`)).filter(Boolean));
  }

  for (const stage of all(".stage")) setUpStage(stage);
  for (const card of all(".card")) {
    for (const button of all(".controls [data-mode]", card)) button.addEventListener("click", () => show(card, button));
    const enlarge = card.querySelector(".enlarge");
    enlarge.addEventListener("click", () => {
      const wide = card.classList.toggle("wide");
      enlarge.textContent = wide ? "Reduce" : "Enlarge";
      card.scrollIntoView({ block: "nearest" });
    });
  }
  for (const button of all(".bar-all [data-mode]")) {
    button.addEventListener("click", () => {
      press(button);
      for (const card of all(".card")) show(card, button);
    });
  }
  for (const button of all("[data-sort]")) button.addEventListener("click", () => sortBy(button));
})();
