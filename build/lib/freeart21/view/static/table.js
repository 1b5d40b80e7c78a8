/* A table whose rows are sorted by a click on a heading, and turned round by a second one. */

FreeArt.kinds.table = (section) => {
  const body = section.querySelector("tbody");
  const value = (row, column) => {
    const text = row.children[column].dataset.value;
    return text !== "" && Number.isFinite(Number(text)) ? Number(text) : text;
  };
  for (const button of section.querySelectorAll("button[data-column]")) {
    button.addEventListener("click", () => {
      const column = Number(button.dataset.column);
      const heading = button.parentElement;
      const down = heading.getAttribute("aria-sort") === "ascending";
      for (const other of section.querySelectorAll("th[aria-sort]")) other.removeAttribute("aria-sort");
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      const rows = [...body.children].sort((a, b) => {
        const [x, y] = [value(a, column), value(b, column)];
        return (x < y ? -1 : x > y ? 1 : 0) * (down ? -1 : 1);
      });
      body.append(...rows);
    });
  }
};
