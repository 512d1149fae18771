// Tables of class "sortable": a click on a head sorts by that column, numbers as numbers, empty cells last.

function makeSortable(table) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  const first = new Map([...body.rows].map((row, i) => [row, i]));
  heads.forEach((head, column) => {
    const button = el("button", { type: "button", class: "sort", title: head.title || null }, ...head.childNodes);
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const was = head.getAttribute("aria-sort");
      const order = was === null ? "ascending" : was === "ascending" ? "descending" : null;
      for (const other of heads) other.removeAttribute("aria-sort");
      if (order) head.setAttribute("aria-sort", order);
      const sign = order === "descending" ? -1 : 1;
      const rows = [...body.rows].sort((a, b) => order ? compareCells(a.cells[column], b.cells[column], sign) || first.get(a) - first.get(b) : first.get(a) - first.get(b));
      body.append(...rows);
    });
  });
}

function compareCells(a, b, sign) {
  const [x, y] = [a, b].map((cell) => cell.dataset.value ?? cell.textContent.trim());
  if (x === "" || y === "") return x === y ? 0 : x === "" ? 1 : -1;
  const numbers = [Number(x), Number(y)];
  return sign * (numbers.some(Number.isNaN) ? x.localeCompare(y, "en", { numeric: true }) : numbers[0] - numbers[1]);
}
