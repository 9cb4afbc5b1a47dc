// One test along its record: measured and predicted, innovations over time, a smoothed state, innovations against the normal law.
const WIDTH = 2; // standard deviations of a band
const [PREDICTED, SMOOTHED] = ["predicted ± 2 σ", "smoothed ± 2 σ"];
const NORMAL = 1.959964;

// Numbers that are all the same are written once, and times that others have before not at all.
const spread = (numbers, n) => (Array.isArray(numbers) ? numbers : new Array(n).fill(numbers));
const unfolded = (test) => {
  const { at } = test;
  const measurement = (own) => {
    const times = own.at || at;
    const n = times.length;
    const zAt = own.zAt || times;
    const [measured, predicted, sd] = [own.measured, own.predicted, own.sd].map((numbers) => spread(numbers, n));
    return { ...own, at: times, measured, predicted, sd, zAt, z: spread(own.z, zAt.length) };
  };
  const state = (own) => ({ ...own, mean: spread(own.mean, at.length), sd: spread(own.sd, at.length) });
  return { ...test, at, measurements: test.measurements.map(measurement), states: test.states.map(state) };
};

const most = (data, what) =>
  data.tests.reduce((longest, test) => (test[what].length > longest.length ? test[what] : longest), []).map((one) => one.name);

// A band of two standard deviations about a mean, drawn as one shape.
const band = (look, name, at, mean, sd, axes) => {
  const rows = at.map((t, i) => [t, mean[i] - WIDTH * sd[i], mean[i] + WIDTH * sd[i]]).filter((row) => row.every(known));
  return {
    type: "custom", name, silent: true, clip: true, ...axes, encode: { x: 0, y: [1, 2] }, data: rows, itemStyle: { color: look.band },
    renderItem(params, api) {
      if (params.dataIndex > 0) return undefined;
      const edge = (k) => rows.map((row) => api.coord([row[0], row[k]]));
      return { type: "polygon", shape: { points: [...edge(1), ...edge(2).reverse()] }, style: { fill: look.band } };
    },
  };
};
const curveOf = (name, at, mean, color, axes) => ({
  type: "line", name, symbol: "none", silent: true, ...axes, data: at.map((t, i) => [t, value(mean[i])]),
  lineStyle: { color, width: 1.5 }, itemStyle: { color },
});
const dotsOf = (name, at, values, color, axes, more = {}) => ({
  type: "scatter", name, symbolSize: at.length > 200 ? 3.5 : 5, ...axes, itemStyle: { color },
  data: at.map((t, i) => [t, values[i]]).filter((row) => row.every(known)), ...more,
});

const recordSeries = (look, own, state, test) => {
  const [top, middle, below, last] = [0, 1, 2, 3].map((k) => ({ xAxisIndex: k, yAxisIndex: k }));
  const series = [];
  if (own) {
    series.push(band(look, PREDICTED, own.at, own.predicted, own.sd, top));
    series.push(curveOf("predicted", own.at, own.predicted, look.soft, top));
    series.push(dotsOf("measured", own.at, own.measured, look.mark, top));
    const bounds = dashed(look, [{ yAxis: -NORMAL }, { yAxis: NORMAL }], "");
    series.push(dotsOf("innovation", own.zAt, own.z, look.mark, middle, { markLine: bounds }));
    series.push({
      type: "line", name: "normal distribution", symbol: "none", silent: true, ...last, data: [-9, 9].map((q) => [q, q]),
      lineStyle: { color: look.soft, width: 1.5 },
    });
    series.push(dotsOf("in order", own.q.map((pair) => pair[0]), own.q.map((pair) => pair[1]), look.mark, last));
  }
  if (state) {
    series.push(band(look, "smoothed, band", test.at, state.mean, state.sd, below));
    series.push(curveOf(SMOOTHED, test.at, state.mean, look.series[1], below));
  }
  return series;
};

const spanOf = (lists) => {
  const all = lists.flat().filter(known);
  if (!all.length) return {};
  const [low, high] = [Math.min(...all), Math.max(...all)];
  const room = 0.05 * (high - low) || 0.05 * Math.abs(high) || 0.5;
  return { min: low - room, max: high + room };
};
// What was measured, with room for the usual band: that of the first steps may be very wide, and leaves the picture.
const seenSpan = (own) => {
  const usual = own.sd.filter(known).sort((a, b) => a - b)[Math.floor(own.sd.length / 2)] || 0;
  const { min, max } = spanOf([own.measured]);
  return known(min) ? { min: min - 1.5 * WIDTH * usual, max: max + 1.5 * WIDTH * usual } : spanOf(around(own.predicted, own.sd));
};
const around = (mean, sd) => [mean.map((m, i) => m - WIDTH * sd[i]), mean.map((m, i) => m + WIDTH * sd[i])];

const recordAxes = (data, test, own, state, look) => {
  const ends = spanOf([test.at, own ? own.at : []]);
  const inner = { showMinLabel: false, showMaxLabel: false };
  const across = (k) => numbers(look, withUnit("time", data.timeUnit), { gridIndex: k, ...ends, axisLabel: inner, splitNumber: look.narrow ? 4 : 8 });
  const up = (name, k, more) => numbers(look, name, { gridIndex: k, nameGap: lane(look) - 20, splitNumber: 4, ...more, axisLabel: inner });
  const wide = (x) => Math.max(2.5, ...x.filter(known).map(Math.abs)) * 1.06;
  const [z, q] = own ? [wide(own.z), wide(own.q.map((pair) => pair[0]))] : [2.5, 2.5];
  return {
    xAxis: [across(0), across(1), across(2), numbers(look, look.narrow ? "normal distribution" : "quantile of the normal distribution", { gridIndex: 3, min: -q, max: q, axisLabel: inner })],
    yAxis: [
      up(own ? own.name : "", 0, own ? seenSpan(own) : {}),
      up("innovation / σ", 1, { min: -z, max: z }),
      up(state ? withUnit(state.name, state.unit) : "", 2, state ? spanOf(around(state.mean, state.sd)) : {}),
      up("innovation / σ", 3, { min: -z, max: z }),
    ],
  };
};

// The first state that moves: one that does not is in the tables already.
const moving = (data, names) => {
  const moves = (state) => Array.isArray(state.mean);
  return Math.max(0, names.findIndex((name) => data.tests.some((test) => test.states.some((own) => own.name === name && moves(own)))));
};

const left = (drawn, all, what) => (drawn < all ? `${drawn} of ${all} ${what} are drawn, at equal distances and the largest. ` : "");
const remark = (test, own) =>
  own
    ? left(own.at.length, own.values, "values") + left(own.zAt.length, own.innovations, "innovations") +
      (test.at.length < test.steps ? `States at ${test.at.length} of ${test.steps} steps.` : "")
    : "Nothing was measured in this record.";

const recordTip = (data, own, state) => (hit) => {
  const [x, y] = hit.value;
  if (hit.seriesName === "in order") return `innovation ${number(y, 3)}<br>normal quantile ${number(x, 3)}`;
  const time = `${safe(withUnit("time", data.timeUnit))} ${tick(x)}<br>`;
  if (hit.seriesName === "innovation") return `${time}${number(y, 3)} standard deviations`;
  const i = own.at.indexOf(x);
  const predicted = i < 0 ? "" : `<br>predicted ${number(own.predicted[i])} ± ${number(own.sd[i], 2)}`;
  return `${time}${safe(own.name)} ${number(y)}${predicted}`;
};

kinds.record = {
  controls: (data) => {
    const [measured, states] = [most(data, "measurements"), most(data, "states")];
    return [
      { key: "test", label: "Test", options: data.tests.map((test) => test.id), initial: 0 },
      ...(measured.length > 1 ? [{ key: "measurement", label: "Measurement", options: measured, initial: 0 }] : []),
      ...(states.length > 1 ? [{ key: "state", label: "State", options: states, initial: moving(data, states) }] : []),
    ];
  },
  option(data, state, look) {
    const test = unfolded(data.tests[state.test || 0]);
    const names = { measurements: most(data, "measurements"), states: most(data, "states") };
    const named = (what, k) => test[what].find((one) => one.name === names[what][k || 0]);
    const own = named("measurements", state.measurement);
    const told = named("states", state.state);
    const shared = common(look, { yAxisIndex: "none", xAxisIndex: [0, 1, 2] });
    const grid = (top, height) => ({ left: lane(look) + 10, right: 16, top, height, outerBoundsMode: "none" });
    return {
      height: 1010,
      note: remark(test, own),
      option: {
        ...shared,
        legend: {
          top: 0, left: 0, right: 90, type: "scroll", selectedMode: false, textStyle: { color: look.ink }, pageTextStyle: { color: look.soft },
          data: ["measured", PREDICTED, SMOOTHED],
        },
        grid: [grid(36, 200), grid(296, 150), grid(506, 170), grid(736, 220)],
        ...recordAxes(data, test, own, told, look),
        dataZoom: [wheel({ xAxisIndex: [0, 1, 2] })],
        series: recordSeries(look, own, told, test),
        tooltip: { ...shared.tooltip, formatter: recordTip(data, own, told) },
      },
    };
  },
};
