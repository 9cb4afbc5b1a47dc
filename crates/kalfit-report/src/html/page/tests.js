// Tests among the others.
const CHI2_50 = 1.386294361, CHI2_95 = 5.991464547; // two degrees of freedom

// Points of (x - m)' C⁻¹ (x - m) = level, from the principal axes of C.
const ellipse = (m, c, level) => {
  const [a, b, d] = [c[0][0], c[0][1], c[1][1]];
  if (![a, b, d].every(known)) return [];
  // in units of the standard deviations, so that axes of very different size do not lose digits
  const sx = Math.sqrt(Math.max(a, 0)), sy = Math.sqrt(Math.max(d, 0));
  const r = sx > 0 && sy > 0 ? Math.max(-1, Math.min(1, b / (sx * sy))) : 0;
  const major = Math.sqrt(level * (1 + r) / 2), minor = Math.sqrt(level * (1 - r) / 2);
  return Array.from({ length: 97 }, (_, k) => {
    const t = (2 * Math.PI * k) / 96, u = major * Math.cos(t), v = minor * Math.sin(t);
    return [m[0] + sx * (u - v), m[1] + sy * (u + v)];
  });
};
const pick = (matrix, i, k) => [[matrix[i][i], matrix[i][k]], [matrix[k][i], matrix[k][k]]];

kinds.ellipses = {
  controls: (data) => [
    { key: "x", label: "Across", options: data.states, initial: 0 },
    { key: "y", label: "Up", options: data.states, initial: 1 },
  ],
  option(data, state, look) {
    const { x: i, y: k } = state;
    const centre = [data.mean[i], data.mean[k]];
    const wide = ellipse(centre, pick(data.covariance, i, k), CHI2_95);
    const far = [3 * Math.sqrt(data.covariance[i][i]), 3 * Math.sqrt(data.covariance[k][k])];
    const inside = (p) => p.every((x, d) => Math.abs(x - centre[d]) <= 2 * far[d]);
    const own = [], posterior = [], threads = [];
    let beyond = 0;
    data.tests.forEach((test, j) => {
      const at = [test.mean[i], test.mean[k]], alone = [test.own[i], test.own[k]];
      if (!at.every(known)) return;
      posterior.push({ value: at, j, symbol: test.out ? "diamond" : "circle", symbolSize: test.out ? 11 : 6, itemStyle: { color: test.out ? look.out : look.mark }, label: { show: test.out, formatter: shorten(test.id, 16), position: "right", color: look.ink, fontSize: 11 } });
      if (!alone.every(known)) return;
      if (!inside(alone)) { beyond += 1; return; }
      own.push({ value: alone, j });
      threads.push([...at, ...alone]);
    });
    const marks = [...posterior, ...own].map((point) => point.value).concat(wide);
    const range = (d) => {
      const all = marks.map((p) => p[d]), low = Math.min(...all), high = Math.max(...all), pad = 0.06 * (high - low || Math.abs(high) || 1);
      return { min: low - pad, max: high + pad };
    };
    const contour = (points, name, type) => ({ type: "line", name, data: points, symbol: "none", silent: true, lineStyle: { color: look.mark, width: 1.5, type }, itemStyle: { color: look.mark } });
    const edge = (name, d) => numbers(look, name, { ...range(d), nameGap: d ? 54 : 28, splitNumber: look.narrow ? 4 : 6, axisLabel: { showMinLabel: false, showMaxLabel: false } });
    const bare = data.tests.length - own.length - beyond;
    const note = [beyond ? `${beyond} of the tests' own estimates ${beyond === 1 ? "lies" : "lie"} beyond the picture.` : "", bare && own.length + beyond ? `${bare === 1 ? "1 test does" : `${bare} tests do`} not determine both states alone.` : "", !own.length && !beyond ? "No test determines both states alone." : ""].filter(Boolean).join(" ");
    return {
      height: Math.min(540, Math.max(340, look.width * 0.7)), note,
      hover: { series: ["alone", "given"], mark: "error", points: (j) => { const t = data.tests[j]; return ellipse([t.own[i], t.own[k]], pick(t.ownCovariance, i, k), CHI2_95); } },
      option: {
        ...common(look, {}),
        legend: { top: 0, left: 0, itemWidth: 16, textStyle: { color: look.ink }, data: look.narrow ? ["95 %", "alone", "given"] : ["50 %", "95 %", "alone", "given"], selectedMode: false,
          formatter: (name) => ({ alone: look.narrow ? "alone" : "test by itself", given: look.narrow ? "given all" : "given the population" })[name] || name },
        grid: { left: look.narrow ? 64 : 78, right: 20, top: 36, bottom: 48, outerBoundsMode: "none" },
        xAxis: edge(withUnit(data.states[i], data.units[i]), 0), yAxis: edge(withUnit(data.states[k], data.units[k]), 1),
        dataZoom: [wheel({ xAxisIndex: 0 }), wheel({ yAxisIndex: 0 })],
        series: [
          contour(ellipse(centre, pick(data.covariance, i, k), CHI2_50), "50 %", "dashed"), contour(wide, "95 %", "solid"),
          { type: "custom", name: "threads", silent: true, data: threads, encode: { x: [0, 2], y: [1, 3] }, clip: true,
            renderItem: (params, api) => { const p = api.coord([api.value(0), api.value(1)]), q = api.coord([api.value(2), api.value(3)]); return line(p[0], p[1], q[0], q[1], look.soft, 0.7); } },
          { id: "error", type: "line", name: "error", data: [], symbol: "none", silent: true, lineStyle: { color: look.out, width: 1, type: "dotted" } },
          { type: "scatter", name: "alone", data: own, symbol: "circle", symbolSize: 8, itemStyle: { color: look.paper, borderColor: look.series[1], borderWidth: 1.5 } },
          { type: "scatter", name: "given", data: posterior, itemStyle: { color: look.mark } },
        ],
        tooltip: { ...common(look).tooltip, formatter: (hit) => {
          const how = hit.seriesName === "alone" ? "by itself" : "given the population";
          return `<b>${safe(data.tests[hit.data.j].id)}</b>, ${how}<br>${safe(data.states[i])} ${number(hit.value[0])}<br>${safe(data.states[k])} ${number(hit.value[1])}`;
        } },
      },
    };
  },
};

// Estimates with error bars over an axis of tests.
const whiskers = (look, items, more = {}) => ({
  type: "custom", clip: true, encode: { x: 0, y: [1, 2, 3] }, data: items.map((item, i) => [i, value(item.at), value(item.low), value(item.high)]),
  renderItem(params, api) {
    const item = items[params.dataIndex];
    const [x, y] = api.coord([api.value(0), api.value(1)]);
    const low = api.coord([api.value(0), api.value(2)])[1], high = api.coord([api.value(0), api.value(3)])[1];
    const color = item.out ? look.out : look.mark;
    const mark = item.out ? diamond(x, y, 6, color, look.paper) : dot(x, y, 3.2, color, color);
    return { type: "group", children: [line(x, low, x, high, item.thick ? look.pale : color, item.thick || 1.3), mark] };
  },
  ...more,
});
const testAxis = (look, names) => axis(look, {
  type: "category", data: names, name: "test", nameLocation: "middle", nameGap: 74, splitLine: { show: false },
  axisLabel: { formatter: (name) => shorten(name, 10), rotate: names.length > (look.narrow ? 6 : 14) ? 60 : 0 },
});
const testGrid = { left: 64, right: 16, top: ABOVE, bottom: 98, outerBoundsMode: "none" };

kinds.posteriors = {
  controls: (data) => (data.states.length > 1 ? [{ key: "state", label: "State", options: data.states, initial: 0 }] : []),
  option(data, state, look) {
    const s = state.state || 0;
    const tests = data.tests.filter((test) => known(test.mean[s])).sort((a, b) => a.mean[s] - b.mean[s]);
    const items = tests.map((test) => ({ at: test.mean[s], low: test.mean[s] - 1.96 * test.sd[s], high: test.mean[s] + 1.96 * test.sd[s], out: test.out }));
    const [mean, half] = [data.mean[s], 1.96 * data.sd[s]];
    const drawn = known(mean) && known(half);
    const ends = items.flatMap((item) => [item.low, item.high]).concat(drawn ? [mean - half, mean + half] : []).filter(known);
    const [low, high] = [Math.min(...ends), Math.max(...ends)], pad = 0.05 * (high - low || Math.abs(high) || 1);
    return {
      height: 380,
      option: {
        ...common(look, {}), grid: testGrid,
        xAxis: testAxis(look, tests.map((test) => test.id)),
        yAxis: numbers(look, withUnit(data.states[s], data.units[s]), { nameGap: 50, min: low - pad, max: high + pad,
          axisLabel: { showMinLabel: false, showMaxLabel: false } }),
        dataZoom: [wheel({ xAxisIndex: 0 })],
        series: [whiskers(look, items, {
          markArea: drawn && half > 0 ? { silent: true, itemStyle: { color: look.band }, data: [[{ yAxis: mean - half }, { yAxis: mean + half }]] } : undefined,
          markLine: drawn ? dashed(look, [{ yAxis: mean }], "") : undefined,
        })],
        tooltip: { ...common(look).tooltip, formatter: (hit) => `<b>${safe(tests[hit.dataIndex].id)}</b><br>${safe(data.states[s])} ${number(tests[hit.dataIndex].mean[s])} ± ${number(tests[hit.dataIndex].sd[s], 2)}` },
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
      height: 340, note: beyond ? `${beyond} tests with p-values below 1e−30 are drawn at the top.` : "",
      option: {
        ...common(look, {}),
        grid: { left: 56, right: 20, top: ABOVE, bottom: 48, outerBoundsMode: "none" },
        xAxis: numbers(look, look.narrow ? "−log₁₀ p expected" : "−log₁₀ p expected of the tests in order", { scale: false, min: 0, max: longest, axisLabel: { showMaxLabel: false } }),
        yAxis: numbers(look, "−log₁₀ p found", { scale: false, min: 0, max: end, nameGap: 36, axisLabel: { showMaxLabel: false } }),
        dataZoom: [wheel({ xAxisIndex: 0 }), wheel({ yAxisIndex: 0 })],
        series: [
          { type: "line", data: [[0, 0], [Math.min(longest, end), Math.min(longest, end)]], symbol: "none", silent: true, lineStyle: { color: look.rule, width: 1.5 } },
          { type: "scatter", symbolSize: 7, data: data.points.map((p) => ({ value: [p.x, Math.min(p.y, 30)], symbol: p.out ? "diamond" : "circle", symbolSize: p.out ? 11 : 7, itemStyle: { color: p.out ? look.out : look.mark }, label: { show: p.out, formatter: shorten(p.id, 16), position: "left", color: look.ink, fontSize: 11 } })),
            markLine: dashed(look, [{ yAxis: data.limit }], "stands out above", { label: { position: "insideStartTop", color: look.soft, fontSize: 11, formatter: "stands out above" } }) },
        ],
        tooltip: { ...common(look).tooltip, formatter: (hit) => `<b>${safe(data.points[hit.dataIndex].id)}</b><br>p-value ${safe(data.points[hit.dataIndex].p)}` },
      },
    };
  },
};

kinds.influence = {
  controls: (data) => (data.means.length ? [{ key: "what", label: "Show", options: ["all estimates together", ...data.means.map((name) => `mean of ${name}`)], initial: 0 }] : []),
  option(data, state, look) {
    const which = (state.what || 0) - 1;
    const values = data.tests.map((test) => (which < 0 ? test.displacement : test.shifts[which]));
    return barOption(look, {
      names: data.tests.map((test) => test.id), values, axis: "test left out", unit: which < 0 ? "displacement" : "shift in standard errors",
      limit: which < 0 ? data.limit : undefined, limitName: "50 % region", color: (x) => (which < 0 && x > data.limit ? look.out : look.mark),
    });
  },
};
