// Sorts a table on a click on a column heading, and switches between dark and light.
(() => {
  const number = (text) => {
    const plain = text.replace(/\u2212/g, "-").replace(/[\u202f\u00a0]/g, "");
    const found = plain.match(/^[^\d-]*(-?\d+(\.\d+)?(e-?\d+)?)/);
    return found ? Number(found[1]) : NaN;
  };
  const compare = (a, b, column) => {
    const [p, q] = [a, b].map((row) => row.cells[column]?.textContent.trim() ?? "");
    const [x, y] = [number(p), number(q)];
    if (Number.isNaN(x) && Number.isNaN(y)) return p.localeCompare(q);
    if (Number.isNaN(x) || Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
    return x - y;
  };
  const sort = (table, head, column) => {
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of head.parentNode.cells) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    const rows = [...table.tBodies[0].rows].sort((a, b) => compare(a, b, column) * (down ? -1 : 1));
    table.tBodies[0].append(...rows);
  };
  for (const table of document.querySelectorAll("table.sort")) {
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      head.tabIndex = 0;
      head.title = "sort";
      head.addEventListener("click", () => sort(table, head, column));
      head.addEventListener("keydown", (event) => event.key === "Enter" && sort(table, head, column));
    });
  }
  const theme = document.getElementById("theme");
  theme.hidden = false;
  theme.addEventListener("click", () => {
    const root = document.documentElement;
    const dark = (root.dataset.theme ?? (matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light")) === "dark";
    root.dataset.theme = dark ? "light" : "dark";
    document.dispatchEvent(new Event("theme"));
  });
})();
