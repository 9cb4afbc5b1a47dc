// The way to the optimum.
kinds.trace = {
  option(data, state, look) {
    const points = data.steps.map((step, i) => [step, data.gap[i]]).filter((p) => known(p[1]) && p[1] > 0);
    const powers = points.map((p) => Math.log10(p[1]));
    const [low, high] = points.length ? [Math.floor(Math.min(...powers)), Math.ceil(Math.max(...powers))] : [-1, 0];
    return {
      height: 280,
      option: {
        ...common(look, {}),
        grid: { left: 72, right: 20, top: ABOVE, bottom: 48, outerBoundsMode: "none" },
        xAxis: numbers(look, "accepted step", { scale: false, minInterval: 1, max: Math.max(...data.steps) }),
        yAxis: numbers(look, "below the best", {
          type: "log",
          min: 10 ** low,
          max: 10 ** Math.max(high, low + 1),
          nameGap: 54,
          axisLabel: {
            formatter: (x) =>
              x
                .toExponential(0)
                .replace("e+0", "")
                .replace("e+", "e")
                .replace("e-", "e−")
                .replace(/^(\d)$/, "$1"),
          },
        }),
        dataZoom: [wheel({ xAxisIndex: 0 })],
        series: [
          {
            type: "line",
            data: points,
            symbol: "circle",
            symbolSize: 7,
            itemStyle: { color: look.mark },
            lineStyle: { color: look.mark, width: 1.5 },
          },
        ],
        tooltip: {
          ...common(look).tooltip,
          formatter: (hit) => `step ${hit.value[0]}<br>${number(hit.value[1], 3)} below the best`,
        },
      },
    };
  },
};
