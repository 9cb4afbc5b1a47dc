// Draws all charts, and again when the size, the theme or the medium changes.
const PRINTED = 680; // pixels across on paper
const figures = [];

const build = (element) => {
  const spec = specs[Number(element.dataset.chart)];
  const figure = {
    element,
    spec,
    kind: kinds[spec.kind],
    plot: element.querySelector(".plot"),
    controls: element.querySelector(".controls"),
    state: {},
    chart: null,
  };
  const wanted = figure.kind.controls ? figure.kind.controls(spec.data) : [];
  wanted.forEach(({ key, label, options, initial }) => {
    figure.state[key] = initial;
    const select = document.createElement("select");
    select.name = key;
    options.forEach((text, i) => select.add(new Option(shorten(text, 60), String(i), i === initial, i === initial)));
    const wrapped = document.createElement("label");
    wrapped.append(label, select);
    select.addEventListener("change", () => {
      figure.state[key] = Number(select.value);
      render(figure);
    });
    figure.controls.append(wrapped);
  });
  figure.note = document.createElement("span");
  figure.note.className = "note";
  figure.note.setAttribute("aria-live", "polite");
  return figure;
};

const render = (figure, printing = false) => {
  const width = printing ? PRINTED : Math.floor(figure.plot.clientWidth);
  if (width < 50) return;
  const { height, option, note, hover } = figure.kind.option(figure.spec.data, figure.state, looks(width));
  if (printing) option.toolbox.show = false;
  if (figure.chart) figure.chart.dispose();
  figure.plot.style.height = printing ? "auto" : `${height}px`;
  figure.width = width;
  figure.chart = echarts.init(figure.plot, null, { renderer: "svg", width, height });
  figure.chart.setOption(option);
  if (note) {
    figure.note.textContent = note;
    figure.controls.append(figure.note);
  } else {
    figure.note.remove();
  }
  if (hover) {
    figure.chart.on("mouseover", (hit) => {
      if (hover.series.includes(hit.seriesName))
        figure.chart.setOption({ series: [{ id: hover.mark, data: hover.points(hit.data.j) }] });
    });
    figure.chart.on("globalout", () => figure.chart.setOption({ series: [{ id: hover.mark, data: [] }] }));
  }
  if (printing) {
    const svg = figure.plot.querySelector("svg");
    if (svg) {
      svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      svg.parentElement.style.cssText = "";
    }
  }
  figure.plot.dataset.drawn = String(Number(figure.plot.dataset.drawn || 0) + 1);
};

const all = (printing = false) => figures.forEach((figure) => render(figure, printing));

const themed = () => {
  const button = document.getElementById("theme");
  const system = matchMedia("(prefers-color-scheme: dark)");
  const dark = () => (document.documentElement.dataset.theme || (system.matches ? "dark" : "light")) === "dark";
  const say = () => {
    button.textContent = dark() ? "Light theme" : "Dark theme";
  };
  button.hidden = false;
  button.addEventListener("click", () => {
    document.documentElement.dataset.theme = dark() ? "light" : "dark";
    say();
    all();
  });
  system.addEventListener("change", () => {
    say();
    all();
  });
  say();
  const print = document.getElementById("print");
  print.hidden = false;
  print.addEventListener("click", () => window.print());
};

const printed = () => {
  // on paper in light colours, at one width; what is folded is opened
  let folded = [];
  window.addEventListener("beforeprint", () => {
    folded = Array.from(document.querySelectorAll("details:not([open])"));
    folded.forEach((one) => {
      one.open = true;
    });
    all(true);
  });
  window.addEventListener("afterprint", () => {
    folded.forEach((one) => {
      one.open = false;
    });
    all();
  });
};

const located = () => {
  const links = new Map(Array.from(document.querySelectorAll("nav a"), (link) => [link.getAttribute("href").slice(1), link]));
  const seen = new IntersectionObserver(
    (entries) =>
      entries.forEach((entry) => {
        if (!entry.isIntersecting) return;
        links.forEach((link) => link.removeAttribute("aria-current"));
        links.get(entry.target.id)?.setAttribute("aria-current", "true");
      }),
    { rootMargin: "0px 0px -70% 0px" },
  );
  document.querySelectorAll("main > section").forEach((section) => seen.observe(section));
};

document.querySelectorAll("table[data-sortable]").forEach(sortable);
document.querySelectorAll("figure[data-chart]").forEach((element) => figures.push(build(element)));
themed();
printed();
located();
all();
reachable();
let waiting = 0;
window.addEventListener("resize", () => {
  cancelAnimationFrame(waiting);
  waiting = requestAnimationFrame(() => {
    figures.filter((figure) => Math.floor(figure.plot.clientWidth) !== figure.width).forEach((figure) => render(figure));
    reachable();
  });
});
document.documentElement.dataset.ready = "true";
