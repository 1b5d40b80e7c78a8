/* Starts every section with the data inside it; sorts tables; then follows the address: #frame=40&state=0.8 */

/** Rows are sorted by a click on a heading's button; a second click reverses them. */
FreeArt.sortable = (table) => {
  const body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const value = (row, column) => {
    const text = row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
    return text !== "" && Number.isFinite(Number(text)) ? Number(text) : text;
  };
  heads.forEach((head, column) => head.querySelector("button")?.addEventListener("click", () => {
    const down = head.getAttribute("aria-sort") === "ascending";
    for (const other of heads) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", down ? "descending" : "ascending");
    body.append(...[...body.rows].sort((a, b) => {
      const [x, y] = [value(a, column), value(b, column)];
      if (typeof x !== typeof y) return typeof x === "number" ? -1 : 1;
      return (x < y ? -1 : x > y ? 1 : 0) * (down ? -1 : 1);
    }));
  }));
};

{
  const bus = FreeArt.makeBus();
  for (const table of document.querySelectorAll("table.sortable")) FreeArt.sortable(table);
  for (const button of document.querySelectorAll("button[data-frame]"))
    button.addEventListener("click", () => bus.show(Number(button.dataset.frame)));
  for (const section of document.querySelectorAll("section[data-kind]"))
    FreeArt.kinds[section.dataset.kind](section, JSON.parse(section.querySelector('script[type="application/json"]').textContent), bus);
  const go = () => {
    const link = Object.fromEntries(new URLSearchParams(location.hash.slice(1)));
    if (link.frame && Number.isFinite(Number(link.frame))) bus.show(Math.round(Number(link.frame)));
    bus.follow(link);
  };
  addEventListener("hashchange", go);
  go();
  document.documentElement.dataset.ready = "yes";
}
