/* Rows of a table are sorted by a click on a heading's button; a second click reverses them. */

FreeArt.sortable = (table) => {
  const body = table.querySelector("tbody"), heads = [...table.querySelectorAll("thead th")];
  const value = (row, column) => {
    const text = row.children[column].dataset.value ?? row.children[column].textContent;
    return text !== "" && Number.isFinite(Number(text)) ? Number(text) : text;
  };
  heads.forEach((head, column) => {
    head.querySelector("button")?.addEventListener("click", () => {
      const down = head.getAttribute("aria-sort") === "ascending";
      for (const other of heads) other.removeAttribute("aria-sort");
      head.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.children].sort((a, b) => {
        const [x, y] = [value(a, column), value(b, column)];
        if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1;
        return (x < y ? -1 : x > y ? 1 : 0) * (down ? -1 : 1);
      });
      body.append(...rows);
    });
  });
};
