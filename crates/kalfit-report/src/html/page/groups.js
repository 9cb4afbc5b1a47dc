// Groups of tests: each has a colour and a shape, so that neither is needed to tell them apart. Diamonds are kept for tests that
// stand out.
const SHAPES = ["circle", "rect", "triangle"];

const groupColor = (look, groups, test, plain = look.mark) =>
  groups ? (known(test.group) ? look.series[test.group] : look.soft) : plain;
const groupSymbol = (groups, test) => (groups && known(test.group) ? SHAPES[test.group % SHAPES.length] : "circle");

// What is drawn of a test: a colour, filled; who stands out has a diamond, and without groups a colour of its own.
const testLook = (look, groups, test) => ({
  symbol: test.out ? "diamond" : groupSymbol(groups, test),
  color: test.out && !groups ? look.out : groupColor(look, groups, test),
});

const square = (x, y, r, fill, stroke) => ({
  type: "rect",
  shape: { x: x - r, y: y - r, width: 2 * r, height: 2 * r },
  style: { fill, stroke, lineWidth: 1 },
});
const triangle = (x, y, r, fill, stroke) => ({
  type: "polygon",
  shape: {
    points: [
      [x, y - r],
      [x + r, y + r],
      [x - r, y + r],
    ],
  },
  style: { fill, stroke, lineWidth: 1 },
});
const drawnMark = (look, { symbol, color }, x, y) => {
  if (symbol === "diamond") return diamond(x, y, 6, color, look.paper);
  return { circle: dot, rect: square, triangle }[symbol](x, y, 3.4, color, color);
};

// Series without points, which the legend shows: ECharts makes legends of series.
const groupName = (groups, k) => `${groups.column} ${groups.names[k]}`;
const groupSeries = (look, groups) =>
  groups
    ? groups.names.map((_, group) => ({
        type: "scatter",
        name: groupName(groups, group),
        data: [],
        silent: true,
        symbol: groupSymbol(groups, { group }),
        itemStyle: { color: look.series[group] },
      }))
    : [];
const groupNames = (groups) => (groups ? groups.names.map((_, k) => groupName(groups, k)) : []);
const groupLegend = (look, groups) =>
  groups
    ? {
        legend: {
          top: 0,
          left: 0,
          right: 90,
          type: "scroll",
          itemWidth: 16,
          selectedMode: false,
          textStyle: { color: look.ink },
          pageTextStyle: { color: look.soft },
          formatter: (name) => shorten(name, 24),
          data: groupNames(groups),
        },
      }
    : {};
const inGroup = (groups, test) =>
  groups && known(test.group) ? `, ${safe(groupName(groups, test.group))}` : "";
