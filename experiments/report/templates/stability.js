// The stability heat map: what each cell stands for on hover or focus, and rows without a defect out of the way.

function startStability(table, data) {
  const cellAt = (target) => target.closest?.("td[data-technique]");
  const show = (cell) => {
    const { technique, case: name } = cell.dataset, levels = data.found[technique]?.[name] ?? [];
    const frame = cell.getBoundingClientRect();
    tooltip.show(el("div", { class: "card-body" }, el("strong", {}, technique), el("p", { class: "details" }, data.cases[name]),
      levels.length ? el("table", { class: "levels" }, el("tbody", {}, levels.map(([level, status, detail]) => el("tr", {},
        el("th", { scope: "row" }, level), el("td", { class: `status ${status}` }, status), el("td", { class: "text" }, detail)))))
        : el("p", { class: "soft" }, "The case means nothing to this technique.")), frame.right, frame.top);
  };
  table.addEventListener("pointerover", (event) => { const cell = cellAt(event.target); cell ? show(cell) : tooltip.hide(); });
  table.addEventListener("pointerleave", () => tooltip.hide());
  table.addEventListener("focusin", (event) => { const cell = cellAt(event.target); if (cell) show(cell); });
  table.addEventListener("focusout", () => tooltip.hide());
  table.addEventListener("keydown", (event) => {
    const cell = cellAt(event.target), step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!cell || !step) return;
    const rows = [...table.tBodies[0].rows].filter((row) => !row.hidden), row = rows[rows.indexOf(cell.parentElement) + step[1]];
    const next = row?.cells[cell.cellIndex + step[0]];
    if (next?.matches("td")) next.focus();
    event.preventDefault();
  });
  const toggle = document.getElementById("stability-bad");
  toggle?.addEventListener("click", () => {
    const only = toggle.getAttribute("aria-pressed") !== "true";
    toggle.setAttribute("aria-pressed", String(only));
    for (const row of table.tBodies[0].rows) row.hidden = only && !row.querySelector(".declared, .broken");
  });
}
