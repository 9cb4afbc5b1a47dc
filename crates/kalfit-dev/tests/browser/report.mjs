// Opens reports in Chromium and asserts what a reader relies on.
// node report.mjs CHROMIUM MODULES REPORT.html...; with SCREENSHOTS=folder it also saves what it saw.
import { createRequire } from "node:module";
import { mkdirSync, readFileSync } from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [, , browserPath, modules, ...files] = process.argv;
const require = createRequire(path.resolve(modules, "none.js"));
const { chromium } = require("playwright-core");
const axeSource = readFileSync(require.resolve("axe-core/axe.min.js"), "utf8");
const screenshots = process.env.SCREENSHOTS;
if (screenshots) mkdirSync(screenshots, { recursive: true });

const WIDTHS = [390, 1280];
const SCHEMES = ["light", "dark"];
const FLAGS = [
  "--no-sandbox",
  "--disable-gpu",
  "--disable-quic",
  "--no-first-run",
  "--disable-background-networking",
  "--disable-component-update",
  "--disable-sync",
];
let passed = 0;
const failures = [];
const check = (where, claim, holds, found = "") => {
  if (holds) passed += 1;
  else failures.push(`${where}: ${claim}${found === "" ? "" : `; found ${found}`}`);
};

/// Opens a report; whatever it says, asks or loads is noted.
const open = async (browser, file, options) => {
  const context = await browser.newContext({ offline: true, ...options });
  const page = await context.newPage();
  const noted = [];
  const url = pathToFileURL(path.resolve(file)).href;
  page.on("console", (message) => noted.push(`console ${message.type()}: ${message.text()}`));
  page.on("pageerror", (error) => noted.push(`error: ${error.message}`));
  page.on("dialog", (dialog) => {
    noted.push(`dialog: ${dialog.message()}`);
    dialog.dismiss();
  });
  page.on("request", (request) => {
    if (request.url() !== url && !/^(data|blob):/.test(request.url())) noted.push(`request: ${request.url()}`);
  });
  await page.goto(url);
  await page
    .waitForSelector("html[data-ready]", { state: "attached", timeout: 20000 })
    .catch(() => noted.push("the script did not come to its end"));
  return { context, page, noted };
};

/// The least number of shapes that the data of a chart must have led to.
const expectedMarks = () => {
  const specs = JSON.parse(document.getElementById("charts").textContent);
  const marks = {
    forest: (d) => d.panels.reduce((sum, panel) => sum + panel.rows.length, 0),
    bars: (d) => d.values.filter((x) => x > 0).length,
    heat: (d) => d.names.length * (d.names.length - 1),
    ellipses: (d) => 2 + d.tests.length,
    posteriors: (d) => 2 * d.tests.length,
    quantiles: (d) => d.points.length,
    influence: (d) => d.tests.filter((t) => t.displacement > 0).length,
    sizes: (d) => 2 * d.tests.length,
    innovations: (d) => d.tests[0].windows.length + d.tests[0].at.length,
    allan: (d) => d.curves[0].points.filter((p) => p.data !== null).length,
    record: (d) => {
      const own = d.tests[0].measurements[0];
      const count = (numbers) => (Array.isArray(numbers) ? numbers.length : 1);
      return own ? count(own.measured) + count(own.z) + own.q.length : 0;
    },
    trace: (d) => d.gap.filter((x) => x > 0).length,
  };
  return Array.from(document.querySelectorAll("figure[data-chart]"), (figure) => {
    const spec = specs[Number(figure.dataset.chart)];
    const svg = figure.querySelector(".plot svg");
    const shapes = svg ? Array.from(svg.querySelectorAll("path, circle, rect, line, polygon, polyline, ellipse")) : [];
    const box = svg ? svg.getBoundingClientRect() : { width: 0, height: 0 };
    const seen = shapes.filter((shape) => {
      const own = shape.getBBox();
      return own.width + own.height > 0;
    }).length;
    return {
      kind: spec.kind,
      title: spec.title,
      width: box.width,
      height: box.height,
      seen,
      expected: marks[spec.kind](spec.data),
      label: figure.querySelector(".plot").getAttribute("aria-label") || "",
      caption: figure.querySelector("figcaption").textContent.trim(),
    };
  });
};

const charts = async (page, where) => {
  for (const chart of await page.evaluate(expectedMarks)) {
    const name = `${where}, chart ${chart.kind} (${chart.title})`;
    check(name, "is drawn", chart.width > 100 && chart.height > 60, `${chart.width} × ${chart.height}`);
    // small symbols are merged into one path where there are very many
    check(name, "has a mark for each of its data", chart.seen >= chart.expected, `${chart.seen} of ${chart.expected}`);
    check(name, "has a caption and a text alternative", chart.caption.length > 40 && chart.label.length > 20, chart.label);
  }
};

const layout = async (page, where) => {
  const wide = await page.evaluate(() => ({
    scroll: document.documentElement.scrollWidth,
    window: window.innerWidth,
    out: Array.from(document.querySelectorAll("main *"))
      .filter((e) => !e.closest(".scroll, .equations, svg, .plot"))
      .filter((e) => e.getBoundingClientRect().right > window.innerWidth + 1)
      .map((e) => e.tagName)
      .slice(0, 5),
  }));
  check(where, "does not scroll sideways", wide.scroll <= wide.window && wide.out.length === 0, JSON.stringify(wide));
};

const accessible = async (page, where) => {
  await page.evaluate(axeSource);
  const found = await page.evaluate(() =>
    axe.run(document, { runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"], resultTypes: ["violations"] }),
  );
  const said = found.violations.map(
    (v) => `${v.id} (${v.nodes.length}): ${v.nodes[0].target.join(" ")} ${v.nodes[0].failureSummary}`,
  );
  check(where, "axe finds nothing", said.length === 0, said.join("\n    "));
};

const sorting = async (page, where) => {
  await page.evaluate(() =>
    document.querySelectorAll("details").forEach((one) => {
      one.open = true;
    }),
  );
  const tables = await page.locator("table[data-sortable]").count();
  check(where, "has tables to sort", tables > 0 || (await page.locator("tbody tr").count()) < 12);
  for (let k = 0; k < tables; k += 1) {
    const table = page.locator("table[data-sortable]").nth(k);
    const heading = table.locator("thead th:has(button)").last();
    await heading.locator("button").focus();
    const column = async () =>
      table.evaluate((t) => {
        let own = 0;
        const headings = Array.from(t.tHead.rows[0].cells);
        const last = headings.filter((h) => h.querySelector("button")).pop();
        for (const h of headings) {
          if (h === last) break;
          own += h.colSpan;
        }
        return Array.from(t.tBodies[0].rows, (row) => row.cells[own].textContent.trim());
      });
    const before = await column();
    await page.keyboard.press("Enter");
    const up = await column();
    await page.keyboard.press("Enter");
    const down = await column();
    const figures = (cells) => cells.map(Number).filter(Number.isFinite);
    const ordered = (cells, sign) => figures(cells).every((x, i, all) => i === 0 || sign * (x - all[i - 1]) >= 0);
    check(`${where}, table ${k}`, "is sorted by Enter, up and down", ordered(up, 1) && ordered(down, -1), `${up} / ${down}`);
    check(`${where}, table ${k}`, "keeps its rows", [...before].sort().join() === [...down].sort().join());
    check(`${where}, table ${k}`, "says how it is sorted", (await heading.getAttribute("aria-sort")) === "descending");
  }
};

const choosing = async (page, where) => {
  const selects = page.locator("figure select");
  for (let k = 0; k < (await selects.count()); k += 1) {
    const select = selects.nth(k);
    if ((await select.locator("option").count()) < 2) continue;
    const figure = select.locator("xpath=ancestor::figure");
    const drawing = () => figure.locator(".plot").evaluate((plot) => plot.innerHTML);
    const before = await drawing();
    await select.focus();
    await page.keyboard.press((await select.evaluate((s) => s.selectedIndex)) === 0 ? "ArrowDown" : "ArrowUp");
    check(`${where}, chooser ${k}`, "another choice changes the chart", (await drawing()) !== before);
  }
};

/// All that can be operated is reached by Tab, and shows it.
const keyboard = async (page, where) => {
  await page.evaluate(() => {
    document.activeElement?.blur();
    window.scrollTo(0, 0);
    window.reached = new Set();
    window.dark = [];
  });
  const all = await page.evaluate(
    () =>
      Array.from(document.querySelectorAll("a[href], button:not([hidden]), select, summary, [tabindex='0']")).filter((e) =>
        e.checkVisibility(),
      ).length,
  );
  for (let k = 0; k < all + 5; k += 1) {
    await page.keyboard.press("Tab");
    await page.evaluate(() => {
      const at = document.activeElement;
      window.reached.add(at);
      if (at !== document.body && getComputedStyle(at).outlineStyle === "none") window.dark.push(at.outerHTML.slice(0, 80));
    });
  }
  const { reached, dark } = await page.evaluate(() => ({
    reached: Array.from(window.reached).filter((e) => e !== document.body).length,
    dark: window.dark,
  }));
  check(where, "Tab reaches all that can be operated", reached >= all, `${reached} of ${all}`);
  check(where, "focus can be seen", dark.length === 0, dark[0]);
};

const hovering = async (page, where) => {
  const plots = page.locator(".plot");
  let tips = 0;
  for (let k = 0; k < (await plots.count()); k += 1) {
    await plots.nth(k).scrollIntoViewIfNeeded();
    const box = await plots.nth(k).boundingBox();
    for (let step = 1; step < 12; step += 1) {
      await page.mouse.move(box.x + (box.width * step) / 12, box.y + box.height * (0.25 + 0.04 * step));
    }
    tips += await plots
      .nth(k)
      .evaluate(
        (plot) =>
          Array.from(plot.children).filter(
            (e) => e.tagName === "DIV" && e.textContent && getComputedStyle(e).position === "absolute",
          ).length,
      );
  }
  check(where, "pointing at charts shows figures", (await plots.count()) === 0 || tips > 0);
  check(
    where,
    "nothing from a name became an element",
    (await page.evaluate(() => document.querySelectorAll("img, iframe, main script, .plot script").length)) === 0,
  );
};

const themes = async (page, where) => {
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const before = await ground();
  await page.locator("#theme").click();
  check(where, "the button changes the theme", (await ground()) !== before);
  await charts(page, `${where}, other theme`);
  await page.locator("#theme").click();
};

const paper = async (page, where, name) => {
  const pdf = await page.pdf({
    format: "A4",
    printBackground: true,
    path: screenshots ? path.join(screenshots, `${name}.pdf`) : undefined,
  });
  check(where, "prints", pdf.length > 10000, pdf.length);
};

const browser = await chromium.launch({ executablePath: browserPath, args: FLAGS });
try {
  for (const file of files) {
    const name = path.basename(file, ".html");
    for (const colorScheme of SCHEMES) {
      for (const width of WIDTHS) {
        const where = `${name}, ${colorScheme}, ${width} px`;
        const { context, page, noted } = await open(browser, file, { colorScheme, viewport: { width, height: 900 } });
        await charts(page, where);
        await layout(page, where);
        if (screenshots)
          await page.screenshot({ path: path.join(screenshots, `${name}-${colorScheme}-${width}.png`), fullPage: true });
        await accessible(page, where);
        if (colorScheme === "light") {
          await sorting(page, where);
          await choosing(page, where);
          await hovering(page, where);
          await layout(page, `${where}, after use`);
        }
        if (width === 1280 && colorScheme === "light") {
          await keyboard(page, where);
          await themes(page, where);
          await paper(page, where, name);
        }
        check(where, "is silent: no message, no error, no request", noted.length === 0, noted.slice(0, 5).join("\n    "));
        await context.close();
      }
    }
  }
} finally {
  await browser.close();
}
failures.forEach((failure) => console.error(`FAILED ${failure}`));
console.log(`${passed} passed, ${failures.length} failed`);
process.exitCode = failures.length === 0 && passed > 0 ? 0 : 1;
