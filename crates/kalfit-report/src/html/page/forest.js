// Estimates with intervals, one axis below the other; and plain bars.
const ROW = 26,
  ABOVE = 30,
  BELOW = 52;

kinds.forest = {
  option(data, state, look) {
    const room = margin(
      data.panels.flatMap((panel) => panel.rows.map((row) => row.name)),
      look,
    );
    const option = { ...common(look, { yAxisIndex: "none" }), grid: [], xAxis: [], yAxis: [], series: [], dataZoom: [] };
    let top = ABOVE;
    data.panels.forEach((panel, k) => {
      const height = Math.max(panel.rows.length * ROW, ROW * 1.5);
      option.grid.push({ left: room, right: 24, top, height, outerBoundsMode: "none" });
      option.xAxis.push(numbers(look, panel.label, { gridIndex: k, splitNumber: look.narrow ? 3 : 6, boundaryGap: ["3%", "3%"] }));
      option.yAxis.push(
        axis(look, {
          gridIndex: k,
          type: "category",
          inverse: true,
          data: panel.rows.map((row) => row.name),
          axisTick: { show: false },
          axisLabel: { color: look.ink, ...fitted(room) },
        }),
      );
      option.series.push(intervals(panel, k, look));
      top += height + BELOW;
    });
    option.dataZoom = data.panels.map((_, k) => wheel({ xAxisIndex: k }));
    option.tooltip.formatter = (hit) => {
      const row = data.panels[hit.seriesIndex].rows[hit.dataIndex];
      return `<b>${safe(row.name)}</b><br>${safe(row.words)}`;
    };
    return { height: top, option };
  },
};

const intervals = (panel, k, look) => ({
  type: "custom",
  xAxisIndex: k,
  yAxisIndex: k,
  name: panel.label,
  clip: true,
  encode: { x: [1, 2, 3, 4], y: 0 },
  data: panel.rows.map((row, i) => [i, value(row.estimate), value(row.low), value(row.high), value(row.reference)]),
  renderItem(params, api) {
    const at = (dimension) => api.coord([api.value(dimension), api.value(0)]);
    const given = (dimension) => Number.isFinite(api.value(dimension));
    const box = params.coordSys;
    const children = [];
    const [x, y] = at(1);
    if (given(2) || given(3)) {
      const from = given(2) ? at(2)[0] : box.x,
        to = given(3) ? at(3)[0] : box.x + box.width;
      children.push(line(from, y, to, y, look.mark, 2));
      if (given(2)) children.push(line(from, y - 5, from, y + 5, look.mark));
      if (given(3)) children.push(line(to, y - 5, to, y + 5, look.mark));
      children.push(dot(x, y, 4.5, look.mark, look.mark));
    } else {
      children.push(dot(x, y, 4.5, look.paper, look.mark));
    }
    if (given(4)) children.push(diamond(at(4)[0], y, 6, look.out, look.paper));
    // a pale ground over the whole row, so that pointing at the row is enough
    children.unshift({
      type: "rect",
      shape: { x: box.x, y: y - ROW / 2, width: box.width, height: ROW },
      style: { fill: look.paper, opacity: 0.01 },
    });
    return { type: "group", children };
  },
  markLine: crossesZero(panel) ? dashed(look, [{ xAxis: 0 }], "") : undefined,
});

const crossesZero = (panel) => {
  const all = panel.rows.flatMap((row) => [row.estimate, row.low, row.high]).filter(known);
  return Math.min(...all) <= 0 && Math.max(...all) >= 0;
};

const barOption = (look, { names, values, unit, axis: of, limit, limitName, tips, color }) => {
  const lying =
    names.length <= 60 &&
    names.some((name) => name.length > 6) &&
    (look.narrow || names.length <= 30 || names.some((name) => name.length > 14));
  const room = lying ? margin(names, look) : 56;
  const largest = Math.max(...values.filter(known), known(limit) ? limit : 0);
  const quantity = numbers(look, unit, {
    scale: false,
    max: known(limit) && limit >= largest ? limit * 1.15 : undefined,
    axisLabel: { showMaxLabel: !(known(limit) && limit >= largest) },
    nameGap: lying ? 28 : 42,
  });
  const category = axis(look, {
    axisLine: { onZero: true, lineStyle: { color: look.soft } },
    ...(lying
      ? {
          type: "category",
          inverse: true,
          data: names,
          axisTick: { show: false },
          axisLabel: { color: look.ink, ...fitted(room) },
        }
      : {
          type: "category",
          data: names,
          name: of,
          nameLocation: "middle",
          nameGap: names.length > (look.narrow ? 8 : 20) ? 70 : 30,
          axisLabel: { formatter: (name) => shorten(name, 10), rotate: names.length > (look.narrow ? 8 : 20) ? 60 : 0 },
        }),
  });
  const height = lying ? ABOVE + Math.max(names.length * 22, 60) + BELOW : 300;
  return {
    height,
    option: {
      ...common(look, lying ? { xAxisIndex: "none" } : { yAxisIndex: "none" }),
      grid: lying
        ? { left: room, right: 30, top: ABOVE, height: height - ABOVE - BELOW, outerBoundsMode: "none" }
        : { left: 60, right: 16, top: ABOVE, bottom: names.length > (look.narrow ? 8 : 20) ? 94 : 54, outerBoundsMode: "none" },
      xAxis: lying ? quantity : category,
      yAxis: lying ? category : quantity,
      dataZoom: [wheel(lying ? { yAxisIndex: 0 } : { xAxisIndex: 0 })],
      series: [
        {
          type: "bar",
          data: values.map((x, i) => ({ value: value(x), itemStyle: { color: color ? color(x, i) : look.mark } })),
          barMaxWidth: 26,
          markLine: known(limit) ? dashed(look, [lying ? { xAxis: limit } : { yAxis: limit }], limitName) : undefined,
        },
      ],
      tooltip: {
        ...common(look).tooltip,
        formatter: (hit) =>
          `<b>${safe(names[hit.dataIndex])}</b><br>${safe(tips ? tips(hit.dataIndex) : `${number(values[hit.dataIndex])} ${unit}`)}`,
      },
    },
  };
};

kinds.bars = {
  option: (data, state, look) =>
    barOption(look, {
      ...data,
      color: (x) => (known(data.limit) && x > data.limit ? look.out : look.mark),
    }),
};
