// Allan deviations: those of the records with their limits, and the line of the model.
// Axes are of logarithms, with marks at 1, 2 and 5 of each decade: few records span many decades.
const log10 = (x) => (known(x) && x > 0 ? Math.log10(x) : null);
const decades = (look, name, all, more) => {
  const logs = all.map(log10).filter(known);
  const [low, high] = [Math.min(...logs) - 0.12, Math.max(...logs) + 0.12];
  const wide = high - low > 4;
  const powers = Array.from({ length: Math.ceil(high) - Math.floor(low) + 1 }, (_, k) => Math.floor(low) + k);
  const marks = powers.flatMap((power) => (wide ? [power] : [power, power + Math.log10(2), power + Math.log10(5)]));
  const customValues = marks.filter((mark) => mark >= low && mark <= high);
  return numbers(look, name, {
    min: low, max: high, ...more, axisTick: { customValues }, axisLabel: { customValues, formatter: (mark) => number(10 ** mark, 3) },
    splitLine: { show: false },
  });
};

kinds.allan = {
  controls: (data) =>
    data.curves.length > 1
      ? [{ key: "curve", label: "Measurement", options: data.curves.map((curve) => curve.name), initial: 0 }]
      : [],
  option(data, state, look) {
    const curve = data.curves[state.curve || 0];
    const points = curve.points;
    const shared = common(look, {});
    const told = [["records", "data"], ["model", "model"]].filter(([, what]) => points.some((p) => known(p[what]))).map(([name]) => name);
    const items = points.filter((p) => known(p.data)).map((p) => [p.time, p.data, p.low ?? p.data, p.high ?? p.data].map(log10));
    const log = (name, all, more) => decades(look, name, all, more);
    return {
      height: 360,
      note: curve.said,
      option: {
        ...shared,
        legend: { top: 0, left: 0, itemWidth: 18, selectedMode: false, textStyle: { color: look.ink }, data: told },
        grid: { left: look.narrow ? 62 : 78, right: 20, top: ABOVE, bottom: 48, outerBoundsMode: "none" },
        xAxis: log(withUnit("averaging time", data.timeUnit), points.map((p) => p.time), {}),
        yAxis: log(withUnit(`Allan deviation of ${curve.name}`, curve.unit), points.flatMap((p) => [p.model, p.data, p.low, p.high]), { nameGap: look.narrow ? 42 : 54 }),
        dataZoom: [wheel({ xAxisIndex: 0 }), wheel({ yAxisIndex: 0 })],
        series: [
          {
            type: "line", name: "model", symbol: "none", data: points.filter((p) => known(p.model)).map((p) => [p.time, p.model].map(log10)),
            lineStyle: { color: look.series[1], width: 2 }, itemStyle: { color: look.series[1] }, silent: true,
          },
          { ...limits(look, items), name: "records", itemStyle: { color: look.mark } },
        ],
        tooltip: {
          ...shared.tooltip,
          formatter: (hit) => {
            const p = points.filter((one) => known(one.data))[hit.dataIndex];
            const model = known(p.model) ? `<br>model ${number(p.model)}` : "";
            return `${safe(withUnit("time", data.timeUnit))} ${number(p.time)}, ${p.n} values<br>records ${number(p.data)} (${number(p.low, 3)} to ${number(p.high, 3)})${model}`;
          },
        },
      },
    };
  },
};

// Points with bars over an axis of numbers.
const limits = (look, items) => ({
  type: "custom",
  clip: true,
  encode: { x: 0, y: [1, 2, 3] },
  data: items,
  renderItem(params, api) {
    const [x, y] = api.coord([api.value(0), api.value(1)]);
    const [low, high] = [2, 3].map((k) => api.coord([api.value(0), api.value(k)])[1]);
    const caps = [low, high].map((at) => line(x - 4, at, x + 4, at, look.mark, 1.3));
    return { type: "group", children: [line(x, low, x, high, look.mark, 1.3), ...caps, dot(x, y, 4, look.mark, look.mark)] };
  },
});
