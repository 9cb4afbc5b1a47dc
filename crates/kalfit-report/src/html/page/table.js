// Tables are sorted by the buttons in their headings.
const figureOf = (text) => {
  const found = text.replace(/−/g, "-").match(/^(?:all |< |± )?(-?\d+(?:\.\d+)?(?:e[+-]?\d+)?)/i);
  return found ? Number(found[1]) - (text.startsWith("<") ? 1e-12 : 0) : NaN;
};
const collator = new Intl.Collator("en", { numeric: true });
const compare = (a, b) => {
  const [x, y] = [figureOf(a), figureOf(b)];
  if (Number.isFinite(x) && Number.isFinite(y)) return x - y;
  if (Number.isFinite(x) !== Number.isFinite(y)) return Number.isFinite(x) ? -1 : 1; // figures before what is not known
  return collator.compare(a, b);
};

const sortable = (table) => {
  const headings = Array.from(table.tHead.rows[0].cells);
  let column = 0;
  headings.forEach((heading) => {
    const own = column;
    column += heading.colSpan;
    if (heading.tagName !== "TH") return;
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = heading.textContent;
    heading.replaceChildren(button);
    button.addEventListener("click", () => {
      const down = heading.getAttribute("aria-sort") === "ascending";
      headings.forEach((other) => other.removeAttribute("aria-sort"));
      heading.setAttribute("aria-sort", down ? "descending" : "ascending");
      const body = table.tBodies[0];
      const text = (row) => row.cells[own].textContent.trim();
      const sign = down ? -1 : 1;
      body.append(...Array.from(body.rows).sort((a, b) => sign * compare(text(a), text(b))));
    });
  });
};

// What scrolls can be reached by the keyboard.
const reachable = () =>
  document.querySelectorAll(".scroll, .equations").forEach((box) => {
    const scrolls = box.scrollWidth > box.clientWidth + 1 || box.scrollHeight > box.clientHeight + 1;
    if (scrolls) {
      box.tabIndex = 0;
      box.setAttribute("role", "group");
      box.setAttribute("aria-label", "Scrolls");
    } else {
      ["tabindex", "role", "aria-label"].forEach((name) => box.removeAttribute(name));
    }
  });
