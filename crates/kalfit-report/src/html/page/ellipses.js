// The population as ellipses, and where the tests lie.
const CHI2_50 = 1.386294361;
const CHI2_95 = 5.991464547; // two degrees of freedom
const BEYOND = 6; // standard deviations from the mean

// Points of (x - m)' C⁻¹ (x - m) = level, in units of the standard deviations: axes of very different size lose no digits.
const ellipse = (m, c, level) => {
  if (![c[0][0], c[0][1], c[1][1]].every(known)) return [];
  const sx = Math.sqrt(Math.max(c[0][0], 0));
  const sy = Math.sqrt(Math.max(c[1][1], 0));
  const r = sx > 0 && sy > 0 ? Math.max(-1, Math.min(1, c[0][1] / (sx * sy))) : 0;
  const major = Math.sqrt((level * (1 + r)) / 2);
  const minor = Math.sqrt((level * (1 - r)) / 2);
  return Array.from({ length: 97 }, (_, k) => {
    const [u, v] = [major * Math.cos((Math.PI * k) / 48), minor * Math.sin((Math.PI * k) / 48)];
    return [m[0] + sx * (u - v), m[1] + sy * (u + v)];
  });
};
const pick = (matrix, i, k) => [
  [matrix[i][i], matrix[i][k]],
  [matrix[k][i], matrix[k][k]],
];

// What each test says by itself and given the population, and the lines between.
const placed = (data, [i, k], centre) => {
  const half = [i, k].map((state) => BEYOND * Math.sqrt(data.covariance[state][state]));
  const inside = (point) => point.every((x, d) => Math.abs(x - centre[d]) <= half[d]);
  const found = { own: [], given: [], threads: [], beyond: 0 };
  data.tests.forEach((test, j) => {
    const [given, own] = [[test.mean[i], test.mean[k]], [test.own[i], test.own[k]]];
    if (!given.every(known)) return;
    found.given.push({ value: given, j });
    if (!own.every(known)) return;
    if (!inside(own)) {
      found.beyond += 1;
      return;
    }
    found.own.push({ value: own, j });
    found.threads.push([...given, ...own]);
  });
  return found;
};

const remarks = (tests, { own, beyond }) => {
  const silent = tests - own.length - beyond;
  const said = [];
  if (beyond) said.push(`${beyond} of the tests' own estimates ${beyond === 1 ? "lies" : "lie"} beyond the picture.`);
  if (silent === tests) said.push("No test determines both states alone.");
  else if (silent) said.push(`${silent === 1 ? "1 test does" : `${silent} tests do`} not determine both states alone.`);
  return said.join(" ");
};

const outlined = (look, groups, test) => ({
  symbol: testLook(look, groups, test).symbol,
  symbolSize: test.out ? 11 : groups ? 7 : 6,
  itemStyle: { color: testLook(look, groups, test).color },
  label: { show: test.out, formatter: shorten(test.id, 16), position: "right", color: look.ink, fontSize: 11 },
});

const alone = (look, borderColor) => ({ color: look.paper, borderColor, borderWidth: 1.5 });
const unfilled = (look, groups, test) =>
  groups ? { symbol: groupSymbol(groups, test), itemStyle: alone(look, groupColor(look, groups, test)) } : {};

const layers = (data, look, found, [half, wide]) => {
  const contour = (name, points, type) => ({
    type: "line", name, data: points, symbol: "none", silent: true,
    lineStyle: { color: look.mark, width: 1.5, type }, itemStyle: { color: look.mark },
  });
  const thread = (params, api) => {
    const [from, to] = [api.coord([api.value(0), api.value(1)]), api.coord([api.value(2), api.value(3)])];
    return line(...from, ...to, look.soft, 0.7);
  };
  return [
    contour("50 %", half, "dashed"),
    contour("95 %", wide, "solid"),
    { type: "custom", silent: true, data: found.threads, encode: { x: [0, 2], y: [1, 3] }, clip: true, renderItem: thread },
    { id: "error", type: "line", data: [], symbol: "none", silent: true, lineStyle: { color: look.out, width: 1, type: "dotted" } },
    {
      type: "scatter", name: "alone", symbol: "circle", symbolSize: 8, itemStyle: alone(look, data.groups ? look.soft : look.series[1]),
      data: found.own.map((point) => ({ ...point, ...unfilled(look, data.groups, data.tests[point.j]) })),
    },
    {
      type: "scatter", name: "given", itemStyle: { color: data.groups ? look.soft : look.mark },
      data: found.given.map((point) => ({ ...point, ...outlined(look, data.groups, data.tests[point.j]) })),
    },
  ];
};

const legendOf = (look, groups) => {
  const words = look.narrow ? { alone: "alone", given: "given all" } : { alone: "test alone", given: "given the population" };
  return {
    top: 0, left: 0, itemWidth: 16, selectedMode: false, textStyle: { color: look.ink },
    ...(groups ? { right: 90, type: "scroll", pageTextStyle: { color: look.soft } } : {}),
    data: [...(look.narrow ? ["95 %", "alone", "given"] : ["50 %", "95 %", "alone", "given"]), ...groupNames(groups)],
    formatter: (name) => words[name] || shorten(name, 24),
  };
};

kinds.ellipses = {
  controls: (data) => [
    { key: "x", label: "Across", options: data.states, initial: 0 },
    { key: "y", label: "Up", options: data.states, initial: 1 },
  ],
  option(data, state, look) {
    const chosen = [state.x, state.y];
    const centre = chosen.map((i) => data.mean[i]);
    const contours = [CHI2_50, CHI2_95].map((level) => ellipse(centre, pick(data.covariance, ...chosen), level));
    const found = placed(data, chosen, centre);
    const points = [...found.given, ...found.own].map((point) => point.value).concat(contours[1]);
    const edge = (d) => {
      const all = points.map((point) => point[d]);
      const [low, high] = [Math.min(...all), Math.max(...all)];
      const pad = 0.06 * (high - low || Math.abs(high) || 1);
      return numbers(look, withUnit(data.states[chosen[d]], data.units[chosen[d]]), {
        min: low - pad, max: high + pad, nameGap: d ? 54 : 28, splitNumber: look.narrow ? 4 : 6,
        axisLabel: { showMinLabel: false, showMaxLabel: false },
      });
    };
    const shared = common(look, {});
    const tip = ({ seriesName, data: { j }, value: [x, y] }) =>
      `<b>${safe(data.tests[j].id)}</b>${inGroup(data.groups, data.tests[j])}, ${seriesName === "alone" ? "by itself" : "given the population"}<br>` +
      `${safe(data.states[chosen[0]])} ${number(x)}<br>${safe(data.states[chosen[1]])} ${number(y)}`;
    const own = (j) => chosen.map((i) => data.tests[j].own[i]);
    return {
      height: Math.min(540, Math.max(340, look.width * 0.7)),
      note: remarks(data.tests.length, found),
      hover: {
        series: ["alone", "given"],
        mark: "error",
        points: (j) => (own(j).every(known) ? ellipse(own(j), pick(data.tests[j].ownCovariance, ...chosen), CHI2_95) : []),
      },
      option: {
        ...shared,
        legend: legendOf(look, data.groups),
        grid: { left: look.narrow ? 64 : 78, right: 20, top: 36, bottom: 48, outerBoundsMode: "none" },
        xAxis: edge(0),
        yAxis: edge(1),
        dataZoom: [wheel({ xAxisIndex: 0 }), wheel({ yAxisIndex: 0 })],
        series: [...layers(data, look, found, contours), ...groupSeries(look, data.groups)],
        tooltip: { ...shared.tooltip, formatter: tip },
      },
    };
  },
};
