// A click on a column's head sorts its table: numbers by size, words by letter; a second click turns the order.
document.querySelectorAll("table.sortable").forEach((table) => {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const key = (row) => row.cells[column].dataset.key ?? row.cells[column].textContent;
      const rows = [...table.tBodies[0].rows];
      rows.sort((a, b) => key(a).localeCompare(key(b), "en", { numeric: true }) * (up ? 1 : -1));
      if (rows.some((row) => row.cells[column].dataset.key)) {
        const size = (row) => (row.cells[column].dataset.key === undefined ? -Infinity : Number(row.cells[column].dataset.key));
        rows.sort((a, b) => (size(a) - size(b)) * (up ? 1 : -1));
      }
      table.tBodies[0].append(...rows);
    });
  });
});
