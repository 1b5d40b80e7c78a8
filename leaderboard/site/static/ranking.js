/* The ranking: sorted by any column, filtered by joint type and category, every column explained; and every sequence.
 * The page is written with all numbers; here they are computed again for the filtered sequences and put in their cells. */

/** As `number_text` of freeart21/view/tables.py. */
FreeArt.numberText = (value, unit, withUnit = false) => {
  if (value === null || value === undefined || unit === null) return "–";
  const size = Math.abs(value), small = size < 10 || unit === "dB" || unit === "fraction";
  const digits = small ? { deg: 2, "%": 2, cm: 2, dB: 1, fraction: 3, m: 4, rad: 3, 1: 3, "dm²": 4, points: 1 }[unit] ?? 2 : size < 99.95 ? 1 : 0;
  return value.toFixed(digits) + (withUnit ? { deg: "°", "%": " %", dB: " dB", cm: " cm", m: " m", rad: " rad" }[unit] ?? "" : "");
};

FreeArt.kinds.ranking = (section, data) => {
  const { element } = FreeArt;
  const state = { type: "all", category: "all", sort: "rank", down: false, metric: data.first };
  const table = section.querySelector("table.ranking"), body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
  const keys = ["rank", "name", "measured", ...data.columns.map((_, k) => String(k))];
  const lines = data.methods.map(({ href }) => [...body.rows].find((row) => row.querySelector("a").getAttribute("href") === href));
  const explain = section.querySelector(".explain");
  const mean = (values) => values.reduce((a, b) => a + b, 0) / values.length;
  const bestOf = (values, up) => (new Set(values).size > 1 ? Math[up ? "max" : "min"](...values) : null);
  const kept = () => data.sequences.map((s) => (state.type === "all" || s.type === state.type)
    && (state.category === "all" || s.category === state.category));

  /* A number that would reveal a hidden truth comes as a mean over all rows of its group, or not at all. */
  const statistics = (method, column, keep, order) => {
    if (column.cells) {
      const cell = state.type === "all" || column.group === state.type ? column.cells[order] : null;
      return cell && { mean: cell[0], std: cell[1] };
    }
    const values = data.sequences.flatMap((s, i) => {
      const value = column.track ? (method.points[column.track]?.[i] ?? null) : method.values[i][column.metric];
      return keep[i] && value !== null && (column.group === "all" || column.group === s.type) ? [value] : [];
    });
    if (!values.length) return null;
    const centre = mean(values), squares = values.map((x) => (x - centre) ** 2);
    return { mean: centre, std: values.length > 1 ? Math.sqrt((mean(squares) * values.length) / (values.length - 1)) : null };
  };
  const summarise = (keep) => {
    const rows = data.methods.map((method, order) => ({ order, name: method.name.toLowerCase(),
      cells: data.columns.map((column) => statistics(method, column, keep, order)),
      measured: keep.filter((on, i) => on && method.status[i] === "ok").length }));
    const means = data.columns.map((_, k) => rows.flatMap((row) => (row.cells[k] ? [row.cells[k].mean] : [])));
    const tracks = data.columns.filter(({ track }) => track).length;
    for (const row of rows) row.rank = row.cells.slice(0, tracks).map((cell) => (cell ? -cell.mean : 1));
    return { rows, means, best: data.columns.map((column, k) => bestOf(means[k], column.up)) };
  };

  const render = () => {
    const keep = kept(), { rows, means, best } = summarise(keep);
    const key = (row) => (state.sort in row ? row[state.sort] : row.cells[state.sort]?.mean ?? null);
    const compare = (x, y) => (x === null || y === null ? (x === null) - (y === null) : (x < y ? -1 : x > y ? 1 : 0));
    const byPoints = (a, b) => a.rank.map((x, k) => x - b.rank[k]).find((d) => d) ?? a.order - b.order;
    const ranked = [...rows].sort(byPoints), all = keep.every(Boolean);
    const sorted = state.sort === "rank" ? (state.down ? [...ranked].reverse() : ranked)
      : [...ranked].sort((a, b) => compare(key(a), key(b)) * (state.down && key(a) !== null && key(b) !== null ? -1 : 1));
    heads.forEach((head, i) => {
      if (state.sort === keys[i]) head.setAttribute("aria-sort", state.down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
      if (i > 2) head.hidden = !means[i - 3].length;
    });
    for (const row of rows) {
      const [place, , measured, ...cells] = lines[row.order].cells;
      place.textContent = all ? data.methods[row.order].place : "–";
      measured.lastElementChild.textContent = `${row.measured} of ${keep.filter(Boolean).length}`;
      cells.forEach((td, k) => {
        const cell = row.cells[k], { unit } = data.columns[k];
        td.hidden = !means[k].length;
        td.classList.toggle("best", cell !== null && cell.mean === best[k]);
        td.querySelector("span").textContent = FreeArt.numberText(cell?.mean, unit);
        td.querySelector(":scope > small").textContent = cell && cell.std !== null && !data.columns[k].track ? `± ${FreeArt.numberText(cell.std, unit)}` : "";
      });
    }
    body.append(...sorted.map((row) => lines[row.order]));
    showSequences(keep);
  };

  /* What a column means: on pointing, on focus, on a tap. */
  const fixed = {
    rank: "Place on the whole: 1 plus the number of methods that are better beyond doubt (paired intervals over all sequences). Methods with one place are tied.",
    name: "The method's name; its page has settings, code and machine.",
    measured: "Sequences that could be measured; the others failed, were missing or could not be read, and count with their penalty in every mean.",
  };
  const tell = (column) => {
    const metric = data.columns[column]?.track ? data.columns[column] : data.metrics[data.columns[column]?.metric];
    explain.replaceChildren(...(metric
      ? [element("b", {}, metric.label), " ", metric.explain, " ", element("a", { href: `definitions.html#${metric.track ? "points" : `${data.protocol}.${metric.id}`}` }, "More")]
      : [fixed[column] ?? ""]));
    explain.classList.add("given");
  };
  for (const event of ["pointerover", "focusin", "click"])
    table.addEventListener(event, ({ target }) => {
      const cell = target.closest?.("button")?.closest("th, td");
      if (cell) tell(keys[cell.cellIndex]);
    });
  const sortBy = (column) => {
    const larger = column === "measured" || data.columns[column]?.up;
    state.down = state.sort === column ? !state.down : Boolean(larger);
    state.sort = column;
    select.value = column;
    render();
  };
  heads.forEach((head, i) => head.querySelector("button").addEventListener("click", () => sortBy(keys[i])));

  /* Filters. */
  const chooser = (label, options, change) => {
    const node = element("select", { "aria-label": label, onchange: () => change(node.value) },
      ...options.map(([value, text]) => element("option", { value }, text)));
    return node;
  };
  const names = ["place", "method", "measured", ...heads.slice(3).map((head) => head.textContent)];
  const select = chooser("sort by", keys.map((value, i) => [value, names[i]]), (value) => {
    state.sort = null;
    sortBy(value);
    tell(value);
  });
  const filter = (name) => (value) => {
    state[name] = value;
    render();
  };
  const types = [...new Set(data.sequences.map(({ type }) => type))].sort().reverse();
  const categories = [...new Set(data.sequences.map(({ category }) => category))].sort();
  const filters = section.querySelector(".filters");
  if (types.length > 1)
    filters.append(FreeArt.choice("joint type", [["all", "All"], ...types.map((type) => [type, type])], "all", filter("type")));
  if (categories.length > 1)
    filters.append(chooser("category", [["all", "all categories"], ...categories.map((name) => [name, name])], filter("category")));
  filters.append(element("label", { class: "sorting" }, "Sort by ", select));

  /* Every sequence by one number. */
  const grid = section.querySelector("table.every"), sequences = [...grid.tBodies[0].rows];
  const pick = chooser("number shown", data.metrics.map(({ label }, k) => [k, label]), (value) => {
    state.metric = Number(value);
    render();
  });
  pick.value = state.metric;
  section.querySelector(".metric").replaceWith(element("div", { class: "filters" }, element("label", {}, "Number ", pick)));
  const showSequences = (keep) => {
    const metric = data.metrics[state.metric];
    sequences.forEach((line, i) => {
      line.hidden = !keep[i];
      const values = data.methods.map((method) => method.values[i][state.metric]);
      const best = bestOf(values.filter((value) => value !== null), metric.up);
      values.forEach((value, m) => {
        const cell = line.cells[3 + m];
        cell.querySelector("span").textContent = FreeArt.numberText(value, metric.units[data.sequences[i].type], true);
        cell.classList.toggle("best", best !== null && value === best);
      });
    });
  };
  render();
};

/* The choice of the protocol: one table at a time. */
(() => {
  const host = document.querySelector("[data-protocols]");
  if (!host) return;
  const boards = [...document.querySelectorAll("section[id^=protocol-]")];
  const show = (name) => {
    for (const board of boards) board.hidden = board.id !== `protocol-${name}`;
  };
  const names = boards.map((board) => board.id.slice("protocol-".length));
  const asked = new URLSearchParams(location.hash.slice(1)).get("protocol");
  const first = names.includes(asked) ? asked : names[0];
  host.append(FreeArt.element("span", { class: "label" }, "Protocol"),
    FreeArt.choice("protocol", names.map((name) => [name, name]), first, show));
  show(first);
})();
