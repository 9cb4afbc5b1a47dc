// What the filter did not expect.
kinds.sizes = {
  option(data, state, look) {
    const largest = Math.max(...data.tests.map((test) => test.ratio));
    const least = Math.min(...data.tests.map((test) => test.ratio).filter((x) => x > 0));
    const log = largest > 20 || least < 0.02;
    const floor = log ? Math.min(least, 0.1) / 2 : 0;
    const items = data.tests.map((test) => ({
      at: log ? Math.max(test.ratio, floor) : test.ratio,
      low: log && known(test.low) ? Math.max(test.low, floor) : test.low,
      high: test.high,
      thick: 6,
      out: known(test.low) && (test.ratio < test.low || test.ratio > test.high),
      group: test.group,
    }));
    return {
      height: 360,
      option: {
        ...common(look, {}),
        ...groupLegend(look, data.groups),
        grid: testGrid,
        xAxis: testAxis(
          look,
          data.tests.map((test) => test.id),
        ),
        yAxis: numbers(look, "mean square", { nameGap: 44, type: log ? "log" : "value", scale: false, min: log ? floor : 0 }),
        dataZoom: [wheel({ xAxisIndex: 0 })],
        series: [
          whiskers(look, items, { groups: data.groups, markLine: dashed(look, [{ yAxis: 1 }], "") }),
          ...groupSeries(look, data.groups),
        ],
        tooltip: {
          ...common(look).tooltip,
          formatter: (hit) => {
            const t = data.tests[hit.dataIndex];
            return `<b>${safe(t.id)}</b>${inGroup(data.groups, t)}<br>mean square ${number(t.ratio)} of ${t.n}<br>95 % bounds ${number(t.low, 3)} to ${number(t.high, 3)}<br>p-value ${safe(t.p)}`;
          },
        },
      },
    };
  },
};

// One test: its innovations over time where they were kept one by one, their size in windows, their autocorrelation. Windows
// come first among the axes, since they are always there.
kinds.innovations = {
  controls: (data) => [{ key: "test", label: "Test", options: data.tests.map((test) => test.id), initial: 0 }],
  option(data, state, look) {
    const test = data.tests[state.test || 0];
    const rows = test.at.length > 0;
    const names = rows ? test.measurements : [];
    const color = (k) => look.series[k % look.series.length];
    const [first, second, third] = rows ? [36, 276, 476] : [0, 36, 236];
    const grid = (top, height) => ({ left: lane(look), right: 16, top, height, outerBoundsMode: "none" });
    const shared = common(look, { yAxisIndex: "none" });
    return {
      height: third + 120 + 48,
      note: test.said + (rows ? "" : " They are too many to be drawn one by one."),
      option: {
        ...shared,
        legend: {
          show: names.length > 1, top: 0, left: 0, right: 90, type: names.length > 3 || look.narrow ? "scroll" : "plain",
          textStyle: { color: look.ink }, data: names, pageTextStyle: { color: look.soft },
        },
        grid: [grid(second, 140), grid(third, 120), ...(rows ? [grid(first, 180)] : [])],
        ...lanes(test, look, rows),
        dataZoom: [wheel({ xAxisIndex: rows ? [0, 2] : [0] })],
        series: [
          windowSeries(test, look),
          ...lagSeries(test, look, color),
          ...names.map((name, k) => pointSeries(test, name, k, look, color(k))),
        ],
        tooltip: { ...shared.tooltip, formatter: (hit) => tip(test, hit) },
      },
    };
  },
};

const lane = (look) => (look.narrow ? 52 : 64);
const when = (test) => (test.timed ? withUnit("time", test.timeUnit) : "step");

const lanes = (test, look, rows) => {
  const ends = [Math.min(...test.windows.map((w) => w.from)), Math.max(...test.windows.map((w) => w.to))];
  const room = 0.01 * (ends[1] - ends[0]) || 0.5;
  const inner = { showMinLabel: false, showMaxLabel: false };
  const lags = test.autocorrelation.flatMap((a) => a.lags).filter(known).map(Math.abs);
  const strongest = Math.max(0.5, Math.ceil(10 * Math.max(0, ...lags)) / 10);
  const across = (k) => numbers(look, when(test), {
    gridIndex: k, min: ends[0] - room, max: ends[1] + room, axisLabel: inner, splitNumber: look.narrow ? 4 : 8,
  });
  const up = (name, k, more) => numbers(look, name, { gridIndex: k, nameGap: lane(look) - 22, ...more });
  const lag = axis(look, {
    gridIndex: 1, axisLine: { onZero: true, lineStyle: { color: look.soft } }, type: "category", data: lagNames(test),
    name: "lag", nameLocation: "middle", nameGap: 28,
  });
  const each = up("innovation / σ", 2, {
    min: (r) => Math.min(-2.5, Math.floor(r.min)), max: (r) => Math.max(2.5, Math.ceil(r.max)), axisLabel: inner,
  });
  return {
    xAxis: [across(0), lag, ...(rows ? [across(2)] : [])],
    yAxis: [
      up("mean square", 0, { scale: false, min: 0 }),
      up(look.narrow ? "autocorr." : "autocorrelation", 1, { min: -strongest, max: strongest, interval: strongest / 2 }),
      ...(rows ? [each] : []),
    ],
  };
};

const tip = (test, hit) => {
  if (hit.seriesType === "custom") {
    const w = test.windows[hit.dataIndex];
    return `${safe(when(test))} ${tick(w.from)} to ${tick(w.to)}<br>mean square ${number(w.ratio, 3)} of ${w.n}<br>` +
      `95 % bounds ${number(w.low, 3)} to ${number(w.high, 3)}`;
  }
  if (hit.seriesType === "bar") {
    return `${safe(hit.seriesName.replace(/^lags of /, ""))}<br>lag ${hit.dataIndex + 1}: ${number(hit.value, 3)}`;
  }
  return `${safe(hit.seriesName)}<br>${safe(when(test))} ${tick(hit.value[0])}<br>${number(hit.value[1], 3)} standard deviations`;
};

const lagNames = (test) =>
  Array.from({ length: Math.max(1, ...test.autocorrelation.map((a) => a.lags.length)) }, (_, k) => String(k + 1));

const pointSeries = (test, name, k, look, color) => ({
  type: "scatter",
  name,
  xAxisIndex: 2,
  yAxisIndex: 2,
  symbolSize: test.at.length > 300 ? 3.5 : 5.5,
  itemStyle: { color },
  data: test.at
    .map((at, i) => [at, test.z[i], test.measurement[i]])
    .filter((row) => row[2] === k && known(row[1]))
    .map((row) => row.slice(0, 2)),
  markLine: k === 0 ? dashed(look, [{ yAxis: -1.96 }, { yAxis: 1.96 }], "") : undefined,
});

// Each window as a bar over its span on a pale ground between its bounds.
const windowSeries = (test, look) => ({
  type: "custom",
  name: "windows",
  xAxisIndex: 0,
  yAxisIndex: 0,
  clip: true,
  encode: { x: [0, 1], y: [2, 3, 4] },
  data: test.windows.map((w) => [w.from, w.to, value(w.ratio), value(w.low), value(w.high)]),
  renderItem(params, api) {
    const w = test.windows[params.dataIndex];
    const [x1, y] = api.coord([w.from, w.ratio]);
    const x2 = Math.max(api.coord([w.to, w.ratio])[0], x1 + 2);
    const out = known(w.low) && (w.ratio < w.low || w.ratio > w.high);
    const children = [line(x1, y, x2, y, out ? look.out : look.mark, out ? 4 : 2.5)];
    if (known(w.low)) {
      const top = api.coord([w.from, w.high])[1],
        bottom = api.coord([w.from, w.low])[1];
      children.unshift({
        type: "rect",
        shape: { x: x1, y: top, width: x2 - x1, height: bottom - top },
        style: { fill: look.band },
      });
    }
    return { type: "group", children };
  },
  markLine: dashed(look, [{ yAxis: 1 }], ""),
});

const lagSeries = (test, look, color) =>
  test.autocorrelation.map((a, k) => ({
    type: "bar",
    name: `lags of ${a.name}`,
    xAxisIndex: 1,
    yAxisIndex: 1,
    data: a.lags.map(value),
    itemStyle: { color: color(Math.max(0, test.measurements.indexOf(a.name))) },
    barMaxWidth: 14,
    markLine: k === 0 ? dashed(look, [{ yAxis: -a.bound }, { yAxis: a.bound }], "") : undefined,
  }));
