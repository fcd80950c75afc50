"use strict";
// On a phone each row of a wide table is a card; its cells say which column they are of.
for (const table of document.querySelectorAll("table.board")) {
  const heads = [...table.querySelectorAll("thead th")].map((head) => head.innerText.trim());
  for (const row of table.tBodies[0].rows) {
    [...row.cells].forEach((cell, column) => {
      if (column) cell.dataset.label = cell.colSpan > 1 ? "" : heads[column];
    });
  }
  if (heads.length > 3) table.classList.add("cards");
}
