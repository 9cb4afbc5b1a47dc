// What all charts share: colours from the style sheet, numbers, the common part of an option.
const specs = JSON.parse(document.getElementById("charts").textContent);
const kinds = {}; // kind -> { controls(data), option(data, state, look) -> { height, option, note } }
const NARROW = 560;
const MISSING = "-"; // what ECharts takes for no value
const FONT = getComputedStyle(document.body).fontFamily;

const safe = (text) => echarts.encodeHTML(String(text));
const known = (x) => x !== null && x !== undefined && Number.isFinite(x);
const value = (x) => (known(x) ? x : MISSING);

const number = (x, digits = 4) => {
  if (!known(x)) return "unknown";
  const size = Math.abs(x);
  if (size !== 0 && (size < 1e-4 || size >= 1e7))
    return x
      .toExponential(digits - 1)
      .replace(/\.?0+e/, "e")
      .replace("-", "−")
      .replace("e-", "e−");
  return String(Number(x.toPrecision(digits))).replace("-", "−");
};
const tick = (x) => number(x, 6);

const shorten = (text, letters) => {
  const all = Array.from(text);
  return all.length > letters ? all.slice(0, letters - 1).join("") + "…" : text;
};

const looks = (width) => {
  const style = getComputedStyle(document.documentElement);
  const of = (name) => style.getPropertyValue("--" + name).trim();
  const names = ["paper", "sheet", "ink", "soft", "rule", "mark", "band", "out", "grid", "cool", "even", "warm", "deep"];
  const look = Object.fromEntries(names.map((name) => [name, of(name)]));
  look.pale = of("mark-pale");
  look.series = [1, 2, 3, 4, 5, 6].map((k) => of("series-" + k));
  look.width = width;
  look.narrow = width < NARROW;
  return look;
};

const axis = (look, more = {}) => {
  const { axisLabel = {}, ...rest } = more;
  return {
    axisLine: { onZero: false, lineStyle: { color: look.soft } },
    axisTick: { lineStyle: { color: look.soft } },
    splitLine: { lineStyle: { color: look.grid } },
    nameTextStyle: { color: look.soft, fontSize: 12 },
    axisLabel: { color: look.soft, fontSize: 12, hideOverlap: true, ...axisLabel },
    ...rest,
  };
};
const numbers = (look, name, more = {}) =>
  axis(look, {
    type: "value",
    scale: true,
    name: name && shorten(name, look.narrow ? 36 : 48),
    nameLocation: "middle",
    nameGap: 28,
    ...more,
    axisLabel: { formatter: tick, ...(more.axisLabel || {}) },
  });

// What stands on every chart; zoomed with a drag of the toolbox's tool, or with ctrl and the wheel, so that pages still scroll.
const common = (look, zoom) => ({
  animation: false,
  textStyle: { fontFamily: FONT, color: look.ink },
  tooltip: {
    confine: true,
    backgroundColor: look.paper,
    borderColor: look.rule,
    textStyle: { color: look.ink, fontSize: 13 },
    extraCssText: "max-width:22rem;white-space:normal;overflow-wrap:anywhere;box-shadow:0 2px 8px rgba(0,0,0,.25)",
  },
  toolbox: {
    right: 4,
    top: 0,
    itemSize: 14,
    itemGap: 10,
    iconStyle: { borderColor: look.soft },
    emphasis: { iconStyle: { borderColor: look.mark, textFill: look.ink } },
    feature: {
      ...(zoom
        ? {
            dataZoom: { ...zoom, title: { zoom: "Zoom", back: "Zoom back" }, brushStyle: { color: look.band } },
            restore: { title: "Reset" },
          }
        : {}),
      saveAsImage: { type: "svg", title: "Save", name: "chart", backgroundColor: look.paper },
    },
  },
});
const wheel = (axes) => ({
  type: "inside",
  zoomOnMouseWheel: "ctrl",
  moveOnMouseWheel: false,
  moveOnMouseMove: true,
  preventDefaultMouseMove: false,
  filterMode: "none",
  ...axes,
});

const dashed = (look, at, label, more = {}) => ({
  silent: true,
  symbol: "none",
  lineStyle: { color: look.soft, type: "dashed", width: 1 },
  label: { show: Boolean(label), formatter: label || "", color: look.soft, fontSize: 11, position: "insideEndTop" },
  data: at,
  ...more,
});

const line = (x1, y1, x2, y2, color, width = 1.5) => ({
  type: "line",
  shape: { x1, y1, x2, y2 },
  style: { stroke: color, lineWidth: width, fill: null },
});
const dot = (x, y, r, fill, stroke) => ({
  type: "circle",
  shape: { cx: x, cy: y, r },
  style: { fill, stroke, lineWidth: 1.5 },
});
const diamond = (x, y, r, fill, stroke) => ({
  type: "polygon",
  shape: {
    points: [
      [x, y - r],
      [x + r, y],
      [x, y + r],
      [x - r, y],
    ],
  },
  style: { fill, stroke, lineWidth: 1.5 },
});

// Names beside a chart get as much room as they need, within bounds.
const margin = (names, look) => {
  const longest = names.reduce((most, name) => Math.max(most, Array.from(name).length), 0);
  return Math.round(Math.min(longest * 7.2 + 16, look.width * (look.narrow ? 0.36 : 0.3)));
};
const fitted = (room) => ({ width: room - 12, overflow: "truncate", hideOverlap: false, interval: 0 });
const withUnit = (name, unit) => (unit ? `${name} [${unit}]` : name);
