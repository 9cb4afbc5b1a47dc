// Tests among the others.
// Estimates with error bars over an axis of tests.
const whiskers = (look, items, { groups, ...more } = {}) => ({
  type: "custom",
  clip: true,
  encode: { x: 0, y: [1, 2, 3] },
  data: items.map((item, i) => [i, value(item.at), value(item.low), value(item.high)]),
  renderItem(params, api) {
    const item = items[params.dataIndex];
    const [x, y] = api.coord([api.value(0), api.value(1)]);
    const low = api.coord([api.value(0), api.value(2)])[1],
      high = api.coord([api.value(0), api.value(3)])[1];
    const drawn = testLook(look, groups, item);
    const bar = line(x, low, x, high, item.thick ? look.pale : drawn.color, item.thick || 1.3);
    return { type: "group", children: [bar, drawnMark(look, drawn, x, y)] };
  },
  ...more,
});
const testAxis = (look, names) =>
  axis(look, {
    type: "category",
    data: names,
    name: "test",
    nameLocation: "middle",
    nameGap: 74,
    splitLine: { show: false },
    axisLabel: { formatter: (name) => shorten(name, 10), rotate: names.length > (look.narrow ? 6 : 14) ? 60 : 0 },
  });
const testGrid = { left: 76, right: 16, top: ABOVE, bottom: 98, outerBoundsMode: "none" };

kinds.posteriors = {
  controls: (data) => (data.states.length > 1 ? [{ key: "state", label: "State", options: data.states, initial: 0 }] : []),
  option(data, state, look) {
    const s = state.state || 0;
    const tests = data.tests.filter((test) => known(test.mean[s])).sort((a, b) => a.mean[s] - b.mean[s]);
    const items = tests.map((test) => ({
      at: test.mean[s],
      low: test.mean[s] - 1.96 * test.sd[s],
      high: test.mean[s] + 1.96 * test.sd[s],
      out: test.out,
      group: test.group,
    }));
    const [mean, half] = [data.mean[s], 1.96 * data.sd[s]];
    const drawn = known(mean) && known(half);
    const ends = items
      .flatMap((item) => [item.low, item.high])
      .concat(drawn ? [mean - half, mean + half] : [])
      .filter(known);
    const [low, high] = [Math.min(...ends), Math.max(...ends)],
      pad = 0.05 * (high - low || Math.abs(high) || 1);
    return {
      height: 380,
      option: {
        ...common(look, {}),
        ...groupLegend(look, data.groups),
        grid: testGrid,
        xAxis: testAxis(
          look,
          tests.map((test) => test.id),
        ),
        yAxis: numbers(look, withUnit(data.states[s], data.units[s]), {
          nameGap: 58,
          min: low - pad,
          max: high + pad,
          axisLabel: { showMinLabel: false, showMaxLabel: false },
        }),
        dataZoom: [wheel({ xAxisIndex: 0 })],
        series: [
          whiskers(look, items, {
            groups: data.groups,
            markArea:
              drawn && half > 0
                ? { silent: true, itemStyle: { color: look.band }, data: [[{ yAxis: mean - half }, { yAxis: mean + half }]] }
                : undefined,
            markLine: drawn ? dashed(look, [{ yAxis: mean }], "") : undefined,
          }),
          ...groupSeries(look, data.groups),
        ],
        tooltip: {
          ...common(look).tooltip,
          formatter: (hit) =>
            `<b>${safe(tests[hit.dataIndex].id)}</b>${inGroup(data.groups, tests[hit.dataIndex])}<br>${safe(data.states[s])} ${number(tests[hit.dataIndex].mean[s])} ± ${number(tests[hit.dataIndex].sd[s], 2)}`,
        },
      },
    };
  },
};

kinds.quantiles = {
  option(data, state, look) {
    const end = Math.max(data.limit, ...data.points.map((p) => Math.max(p.x, Math.min(p.y, 30)))) * 1.08;
    const beyond = data.points.filter((p) => p.y > 30).length;
    const longest = Math.max(...data.points.map((p) => p.x)) * 1.08;
    return {
      height: 340,
      note: beyond ? `${beyond} tests with p-values below 1e−30 are drawn at the top.` : "",
      option: {
        ...common(look, {}),
        ...groupLegend(look, data.groups),
        grid: { left: 56, right: 20, top: ABOVE, bottom: 48, outerBoundsMode: "none" },
        xAxis: numbers(look, look.narrow ? "−log₁₀ p expected" : "−log₁₀ p expected of the tests in order", {
          scale: false,
          min: 0,
          max: longest,
          axisLabel: { showMaxLabel: false },
        }),
        yAxis: numbers(look, "−log₁₀ p found", {
          scale: false,
          min: 0,
          max: end,
          nameGap: 36,
          axisLabel: { showMaxLabel: false },
        }),
        dataZoom: [wheel({ xAxisIndex: 0 }), wheel({ yAxisIndex: 0 })],
        series: [
          {
            type: "line",
            data: [
              [0, 0],
              [Math.min(longest, end), Math.min(longest, end)],
            ],
            symbol: "none",
            silent: true,
            lineStyle: { color: look.rule, width: 1.5 },
          },
          {
            type: "scatter",
            symbolSize: 7,
            data: data.points.map((p) => ({
              value: [p.x, Math.min(p.y, 30)],
              symbol: testLook(look, data.groups, p).symbol,
              symbolSize: p.out ? 11 : 7,
              itemStyle: { color: testLook(look, data.groups, p).color },
              label: { show: p.out, formatter: shorten(p.id, 16), position: "left", color: look.ink, fontSize: 11 },
            })),
            markLine: dashed(look, [{ yAxis: data.limit }], "outliers above", {
              label: { position: "insideStartTop", color: look.soft, fontSize: 11, formatter: "outliers above" },
            }),
          },
          ...groupSeries(look, data.groups),
        ],
        tooltip: {
          ...common(look).tooltip,
          formatter: (hit) => `<b>${safe(data.points[hit.dataIndex].id)}</b>${inGroup(data.groups, data.points[hit.dataIndex])}<br>p-value ${safe(data.points[hit.dataIndex].p)}`,
        },
      },
    };
  },
};

kinds.influence = {
  controls: (data) =>
    data.means.length
      ? [
          {
            key: "what",
            label: "Show",
            options: ["all estimates together", ...data.means.map((name) => `mean of ${name}`)],
            initial: 0,
          },
        ]
      : [],
  option(data, state, look) {
    const which = (state.what || 0) - 1;
    const values = data.tests.map((test) => (which < 0 ? test.displacement : test.shifts[which]));
    return barOption(look, {
      names: data.tests.map((test) => test.id),
      values,
      axis: "test left out",
      unit: which < 0 ? "displacement" : "shift in standard errors",
      limit: which < 0 ? data.limit : undefined,
      limitName: "50 % region",
      color: (x) => (which < 0 && x > data.limit ? look.out : look.mark),
    });
  },
};
