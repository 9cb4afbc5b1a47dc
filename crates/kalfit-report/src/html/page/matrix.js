// Correlations as colours.
kinds.heat = {
  option(data, state, look) {
    const n = data.names.length;
    const room = margin(data.names, look);
    const side = Math.max(12, Math.min(64, (look.width - room - 24) / n));
    const cells = [];
    data.cells.forEach((row, i) =>
      row.forEach((r, k) => {
        if (known(r) && i !== k) cells.push({ value: [k, i, r], label: { color: Math.abs(r) > 0.8 ? look.deep : look.ink } });
      }),
    );
    const labelled = side >= 34;
    const slanted = side < 76;
    const under = slanted ? Math.min(room, 110) * 0.72 + 8 : 28;
    const height = ABOVE + n * side + under + 44;
    return {
      height,
      option: {
        ...common(look, null),
        grid: { left: room, top: ABOVE, width: n * side, height: n * side, outerBoundsMode: "none" },
        xAxis: axis(look, {
          type: "category",
          data: data.names,
          splitLine: { show: false },
          axisLine: { show: false },
          axisTick: { show: false },
          axisLabel: {
            color: look.ink,
            interval: 0,
            hideOverlap: false,
            rotate: slanted ? 50 : 0,
            width: slanted ? 110 : side - 4,
            overflow: "truncate",
          },
        }),
        yAxis: axis(look, {
          type: "category",
          inverse: true,
          data: data.names,
          splitLine: { show: false },
          axisLine: { show: false },
          axisTick: { show: false },
          axisLabel: { color: look.ink, ...fitted(room) },
        }),
        visualMap: {
          min: -1,
          max: 1,
          calculable: true,
          orient: "horizontal",
          left: room,
          bottom: 0,
          itemHeight: Math.min(180, n * side),
          itemWidth: 12,
          precision: 1,
          textStyle: { color: look.soft },
          inRange: { color: [look.cool, look.even, look.warm] },
        },
        series: [
          {
            type: "heatmap",
            data: cells,
            itemStyle: { borderColor: look.paper, borderWidth: 1 },
            label: { show: labelled, fontSize: 12, formatter: (hit) => hit.value[2].toFixed(2).replace("-", "−") },
          },
        ],
        tooltip: {
          ...common(look).tooltip,
          formatter: (hit) =>
            `${safe(data.names[hit.value[1]])} and ${safe(data.names[hit.value[0]])}<br><b>${number(hit.value[2], 3)}</b>`,
        },
      },
    };
  },
};
