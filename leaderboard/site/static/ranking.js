/* The ranking: sorted by any column, filtered by joint type and category, each column explained; and every sequence. */

FreeArt.numberText = (value, unit, signed = false) => {
  if (value === null || value === undefined || unit === null) return "–";
  const size = Math.abs(value), plain = size < 10 || unit === "dB" || unit === "fraction";
  const digits = plain ? { deg: 2, "%": 2, cm: 2, dB: 1, fraction: 3, m: 4, rad: 3, 1: 3, "100 m²": 4 }[unit] ?? 2 : size < 99.95 ? 1 : 0;
  return value.toFixed(digits) + (signed ? { deg: "°", "%": " %", dB: " dB", cm: " cm", m: " m", rad: " rad" }[unit] ?? "" : "");
};

FreeArt.kinds.ranking = (section, data) => {
  const { element } = FreeArt;
  const state = { type: "all", category: "all", sort: "rank", down: false, metric: data.first };
  const table = section.querySelector("table.ranking"), body = table.querySelector("tbody");
  const heads = [...table.querySelectorAll("thead th")];
  const explain = section.querySelector(".explain");
  const kept = () => data.sequences.map((s) => (state.type === "all" || s.type === state.type)
    && (state.category === "all" || s.category === state.category));

  /* A number of a hidden truth comes as a mean over all rows of its group, or not at all. */
  const statistics = (method, column, keep, order) => {
    if (column.cells) {
      const cell = state.type === "all" || column.group === state.type ? column.cells[order] : null;
      return cell && { mean: cell[0], std: cell[1] };
    }
    const values = data.sequences.flatMap((s, i) => {
      const value = method.values[i][column.metric];
      return keep[i] && value !== null && (column.group === "all" || column.group === s.type) ? [value] : [];
    });
    if (!values.length) return null;
    const mean = values.reduce((a, b) => a + b, 0) / values.length;
    const std = values.length > 1 ? Math.sqrt(values.reduce((a, b) => a + (b - mean) ** 2, 0) / (values.length - 1)) : null;
    return { mean, std };
  };
  const lines = () => {
    const keep = kept();
    const rows = data.methods.map((method, order) => ({ method, order,
      cells: data.columns.map((column) => statistics(method, column, keep, order)),
      measured: keep.filter((on, i) => on && method.status[i] === "ok").length, of: keep.filter(Boolean).length }));
    const there = data.columns.map((_, k) => rows.some((row) => row.cells[k]));
    for (const row of rows) {
      const places = data.columns.flatMap((column, k) => {
        if (!there[k]) return [];
        const own = row.cells[k]?.mean;
        if (own === undefined) return [NaN];
        const others = rows.flatMap((other) => (other.cells[k] ? [other.cells[k].mean] : []));
        const better = others.filter((mean) => (column.up ? mean > own : mean < own)).length;
        return [1 + better + 0.5 * (others.filter((mean) => mean === own).length - 1)];
      });
      const mean = places.length ? places.reduce((a, b) => a + b, 0) / places.length : NaN;
      row.rank = Number.isNaN(mean) ? null : mean;
    }
    const best = data.columns.map((column, k) => {
      const means = rows.flatMap((row) => (row.cells[k] ? [row.cells[k].mean] : []));
      return new Set(means).size > 1 ? (column.up ? Math.max(...means) : Math.min(...means)) : null;
    });
    return { rows, best, there };
  };
  const link = (method) => {
    const a = element("a", { class: "method", href: method.href }, FreeArt.mark(method), element("span", {}, method.name));
    return a;
  };
  const label = (title) => {
    const span = element("span", {});
    span.innerHTML = title; /* escaped when the page was written */
    return span.childNodes;
  };

  const key = (row) => {
    if (state.sort === "rank") return row.rank;
    if (state.sort === "name") return row.method.name.toLowerCase();
    if (state.sort === "measured") return row.measured;
    return row.cells[state.sort]?.mean ?? null;
  };
  const render = () => {
    const { rows, best, there } = lines();
    const first = [...rows].sort((a, b) => (a.rank === null) - (b.rank === null) || a.rank - b.rank || a.order - b.order);
    const turn = state.down ? -1 : 1;
    const sorted = [...first].sort((a, b) => {
      const [x, y] = [key(a), key(b)];
      if (x === null || y === null) return (x === null) - (y === null);
      return (x < y ? -1 : x > y ? 1 : 0) * turn;
    });
    heads.slice(3).forEach((head, k) => { head.hidden = !there[k]; });
    heads.forEach((head) => {
      const column = head.querySelector("button").dataset.column;
      if (String(state.sort) === column) head.setAttribute("aria-sort", state.down ? "descending" : "ascending");
      else head.removeAttribute("aria-sort");
    });
    body.replaceChildren(...sorted.map((row) => {
      const line = element("tr", {});
      line.append(element("td", { class: "place" }, row.rank === null ? "–" : String(first.indexOf(row) + 1)),
        element("th", { scope: "row" }, link(row.method)),
        element("td", { class: "number measured" }, element("span", { class: "what" }, "measured"), element("span", {}, `${row.measured} of ${row.of}`)));
      row.cells.forEach((cell, k) => {
        if (!there[k]) return;
        const column = data.columns[k];
        const td = element("td", { class: `number${cell && cell.mean === best[k] ? " best" : ""}` },
          element("button", { type: "button", class: "what", "data-column": k }, ...label(column.title)),
          element("span", {}, cell ? FreeArt.numberText(cell.mean, column.unit) : "–"));
        if (cell && cell.std !== null) td.append(element("small", {}, `± ${FreeArt.numberText(cell.std, column.unit)}`));
        line.append(td);
      });
      return line;
    }));
    matrix();
  };

  /* What a column means: on pointing, on focus, on a tap. */
  const fixed = {
    rank: "Place by mean rank: a method's place by each column, averaged over all columns. Only methods with every number have one.",
    name: "The method's name; its page tells settings, code and machine.",
    measured: "Sequences that were measured; the others failed, were missing or could not be read, and stand at their price in every mean.",
  };
  const tell = (column) => {
    const metric = data.metrics[data.columns[column]?.metric];
    explain.replaceChildren(...(metric
      ? [element("b", {}, metric.label), " ", metric.explain, " ", element("a", { href: `definitions.html#${data.protocol}.${metric.id}` }, "More")]
      : [fixed[column] ?? ""]));
    explain.classList.add("told");
  };
  for (const event of ["pointerover", "focusin", "click"])
    table.addEventListener(event, ({ target }) => {
      const button = target.closest?.("button[data-column]");
      if (button) tell(button.dataset.column);
    });
  const sortBy = (column) => {
    const chosen = /^\d+$/.test(column) ? Number(column) : column;
    const up = typeof chosen === "number" ? data.columns[chosen].up : chosen === "measured";
    state.down = state.sort === chosen ? !state.down : up;
    state.sort = chosen;
    select.value = column;
    render();
  };
  for (const head of heads) head.querySelector("button").addEventListener("click", (event) => sortBy(event.currentTarget.dataset.column));

  /* Filters. */
  const text = (title) => {
    const span = element("span", {});
    span.innerHTML = title;
    return span.textContent;
  };
  const select = element("select", { "aria-label": "sort by" },
    ...[["rank", "mean rank"], ["name", "method"], ["measured", "measured"], ...data.columns.map(({ title }, k) => [String(k), text(title)])]
      .map(([value, name]) => element("option", { value }, name)));
  select.addEventListener("change", () => {
    state.sort = null;
    sortBy(select.value);
    tell(select.value);
  });
  const types = [...new Set(data.sequences.map(({ type }) => type))].sort().reverse();
  const categories = [...new Set(data.sequences.map(({ category }) => category))].sort();
  const options = (all, values) => [element("option", { value: "all" }, all), ...values.map((value) => element("option", { value }, value))];
  const pick = element("select", { "aria-label": "category" }, ...options("all categories", categories));
  pick.addEventListener("change", () => {
    state.category = pick.value;
    render();
  });
  const filters = section.querySelector(".filters");
  if (types.length > 1)
    filters.append(FreeArt.choice("joint type", [["all", "All"], ...types.map((type) => [type, type])], "all", (value) => {
      state.type = value;
      render();
    }));
  if (categories.length > 1) filters.append(pick);
  filters.append(element("label", { class: "sorting" }, "Sort by ", select));

  /* Every sequence by one number. */
  const host = section.querySelector(".matrix"), grid = host.querySelector("table"), lines_ = grid.querySelector("tbody");
  const note = host.querySelector(".metric");
  const metricPick = element("select", { "aria-label": "number shown" },
    ...data.metrics.map(({ label: name }, k) => element("option", { value: k }, name)));
  metricPick.value = state.metric;
  metricPick.addEventListener("change", () => {
    state.metric = Number(metricPick.value);
    render();
  });
  note.replaceWith(element("div", { class: "filters" }, element("label", {}, "Number ", metricPick)));
  const original = [...lines_.children];
  const matrix = () => {
    const keep = kept(), metric = data.metrics[state.metric];
    original.forEach((line, i) => {
      line.hidden = !keep[i];
      const unit = metric.units[data.sequences[i].type];
      const values = data.methods.map((method) => method.values[i][state.metric]);
      const known = values.filter((value) => value !== null);
      const best = new Set(known).size > 1 ? (metric.up ? Math.max(...known) : Math.min(...known)) : null;
      data.methods.forEach((method, m) => {
        const cell = line.children[3 + m];
        cell.querySelector("span").textContent = FreeArt.numberText(values[m], unit, true);
        cell.classList.toggle("best", best !== null && values[m] === best);
      });
    });
  };
  render();
};

/* The chooser of protocols: one table at a time, never two in one. */
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
