"use strict";
// Draws the charts of the page from the data within it, and filters a sweep by its overrides.
(() => {
  const SVG = "http://www.w3.org/2000/svg";
  const LEFT = 58, RIGHT = 12, TOP = 8, BOTTOM = 40;
  const COLOURS = 8, DASHES = ["", "7 4", "2 3"];
  const data = JSON.parse(document.getElementById("data").textContent);
  const hidden = new Set(); // variants that the filter leaves out
  const redraws = [];

  const make = (name, attributes = {}, parent = null, text = null) => {
    const node = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
    if (text !== null) node.textContent = text;
    if (parent) parent.append(node);
    return node;
  };
  const html = (name, className, parent, text = null) => {
    const node = document.createElement(name);
    if (className) node.className = className;
    if (text !== null) node.textContent = text;
    parent.append(node);
    return node;
  };
  const shown = (value) => {
    if (value === null || value === undefined) return "–";
    const size = Math.abs(value);
    if (size !== 0 && (size < 1e-3 || size >= 1e7)) return value.toExponential(2);
    if (size >= 1000) return Math.round(value).toLocaleString("en");
    return String(Number(value.toPrecision(4)));
  };
  const finite = (value) => value !== null && value !== undefined && Number.isFinite(value);

  // Round numbers between two ends, about `count` of them, and how many digits they need.
  const ticks = (low, high, count) => {
    const rough = (high - low) / count;
    const power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map((factor) => factor * power).find((size) => size >= rough);
    const digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    const first = Math.ceil(low / step - 1e-9);
    const found = [];
    for (let i = first; i * step <= high + 1e-9 * step; i += 1) found.push(i * step);
    const label = (value) =>
      digits > 5 ? value.toExponential(1) : Number(value.toFixed(digits)).toLocaleString("en", {
        minimumFractionDigits: digits, maximumFractionDigits: digits,
      });
    return found.map((value) => [value, label(value)]);
  };
  const range = (values, fixed) => {
    if (fixed) return fixed;
    let low = Infinity, high = -Infinity;
    for (const value of values) if (finite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
    if (low > high) return [0, 1];
    if (low === high) return [low - Math.max(Math.abs(low), 1) / 2, high + Math.max(Math.abs(high), 1) / 2];
    const margin = 0.04 * (high - low);
    return [low - margin, high + margin];
  };
  const style = (index) => ({
    colour: `var(--s${index % COLOURS})`,
    dash: DASHES[Math.floor(index / COLOURS) % DASHES.length],
  });

  const axes = (svg, chart, width, height, across, up) => {
    const floor = height - BOTTOM;
    for (const [value, label] of ticks(...across.ends, 6)) {
      const x = across.at(value);
      make("line", { x1: x, x2: x, y1: TOP, y2: floor, class: "grid" }, svg);
      make("text", { x, y: floor + 16, "text-anchor": "middle" }, svg, label);
    }
    for (const [value, label] of up ? ticks(...up.ends, 5) : []) {
      const y = up.at(value);
      make("line", { x1: LEFT, x2: width - RIGHT, y1: y, y2: y, class: "grid" }, svg);
      make("text", { x: LEFT - 7, y: y + 4, "text-anchor": "end" }, svg, label);
    }
    make("text", { x: (across.from + width - RIGHT) / 2, y: height - 6, "text-anchor": "middle", class: "label" }, svg, chart.xlabel);
  };
  const scale = (ends, from, to) => ({
    ends, from, at: (value) => from + ((value - ends[0]) / (ends[1] - ends[0])) * (to - from),
  });

  const path = (xs, ys, across, up) => {
    let text = "", pen = "M", alone = [];
    xs.forEach((x, i) => {
      if (!finite(ys[i])) { pen = "M"; return; }
      const before = i > 0 && finite(ys[i - 1]), after = i + 1 < xs.length && finite(ys[i + 1]);
      if (!before && !after) alone.push([across.at(x), up.at(ys[i])]);
      text += `${pen}${across.at(x).toFixed(1)} ${up.at(ys[i]).toFixed(1)}`;
      pen = "L";
    });
    return [text, alone];
  };
  const band = (xs, low, high, across, up) => {
    const there = xs.map((_, i) => i).filter((i) => finite(low[i]) && finite(high[i]));
    const edge = (ys, order) => order.map((i) => `${across.at(xs[i]).toFixed(1)},${up.at(ys[i]).toFixed(1)}`);
    return [...edge(high, there), ...edge(low, [...there].reverse())].join(" ");
  };

  const lines = (figure, chart) => {
    const width = 500, height = 270;
    const off = new Set();
    const svg = make("svg", { viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": chart.title }, figure);
    const tip = html("div", "tip", figure);
    const legend = html("div", "legend", figure);
    const buttons = chart.series.map((series, index) => {
      const button = html("button", "key", legend);
      button.type = "button";
      button.title = "click: show or hide; double-click: show this one alone";
      const mark = make("svg", { viewBox: "0 0 22 8", class: "stroke" }, button);
      const { colour, dash } = style(series.style ?? index);
      make("line", { x1: 0, x2: 22, y1: 4, y2: 4, style: `stroke:${colour}`, "stroke-dasharray": dash, "stroke-width": 2.5 }, mark);
      html("span", "", button, series.name);
      button.addEventListener("click", () => { off.has(index) ? off.delete(index) : off.add(index); draw(); });
      button.addEventListener("dblclick", () => {
        off.clear();
        chart.series.forEach((_, other) => { if (other !== index) off.add(other); });
        draw();
      });
      return button;
    });
    const there = () => chart.series.map((series, index) => ({ ...series, index })).filter(
      (series) => !off.has(series.index) && !hidden.has(series.variant));
    let across, up, cursor;
    const draw = () => {
      svg.replaceChildren();
      const seen = there();
      const all = seen.flatMap((series) => [series.y, series.low ?? [], series.high ?? []]).flat();
      across = scale(range(chart.x, chart.xrange), LEFT, width - RIGHT);
      up = scale(range(all, chart.yrange), height - BOTTOM, TOP);
      axes(svg, chart, width, height, across, up);
      for (const series of seen) {
        const { colour, dash } = style(series.style ?? series.index);
        if (series.low) make("polygon", { points: band(chart.x, series.low, series.high, across, up), style: `fill:${colour}`, class: "band" }, svg);
        const [text, alone] = path(chart.x, series.y, across, up);
        make("path", { d: text, style: `stroke:${colour}`, "stroke-dasharray": dash, class: "line" }, svg);
        for (const [cx, cy] of alone) make("circle", { cx, cy, r: 2, style: `fill:${colour}` }, svg);
      }
      cursor = make("line", { y1: TOP, y2: height - BOTTOM, class: "cursor", visibility: "hidden" }, svg);
      buttons.forEach((button, index) => {
        button.setAttribute("aria-pressed", String(!off.has(index)));
        button.hidden = hidden.has(chart.series[index].variant);
      });
    };
    const leave = () => { tip.style.display = "none"; cursor.setAttribute("visibility", "hidden"); };
    svg.addEventListener("pointerleave", leave);
    svg.addEventListener("pointermove", (event) => {
      const box = svg.getBoundingClientRect();
      const x = ((event.clientX - box.left) / box.width) * width;
      if (x < LEFT - 5) { leave(); return; }
      let near = 0;
      chart.x.forEach((value, i) => {
        if (Math.abs(across.at(value) - x) < Math.abs(across.at(chart.x[near]) - x)) near = i;
      });
      const at = across.at(chart.x[near]);
      cursor.setAttribute("x1", at);
      cursor.setAttribute("x2", at);
      cursor.setAttribute("visibility", "visible");
      tip.replaceChildren();
      html("b", "", tip, `${shown(chart.x[near])} ${chart.xunit ?? ""}`);
      for (const series of there()) {
        const row = html("div", "", tip);
        html("i", "", row).style.background = style(series.style ?? series.index).colour;
        html("span", "", row, series.name);
        const ends = series.low ? ` (${shown(series.low[near])} to ${shown(series.high[near])})` : "";
        html("em", "", row, shown(series.y[near]) + ends);
      }
      tip.style.display = "block";
      const left = (at / width) * box.width;
      tip.style.left = `${left > box.width / 2 ? left - tip.offsetWidth - 10 : left + 10}px`;
    });
    redraws.push(draw);
    draw();
  };

  const intervals = (figure, chart) => {
    const width = 700;
    const svg = make("svg", { role: "img", "aria-label": chart.title }, figure);
    const wide = 24 + 6.6 * Math.max(...chart.rows.map((row) => row.name.length));
    const left = Math.min(wide, 0.6 * width);
    const draw = () => {
      const rows = chart.rows.filter((row) => !hidden.has(row.variant));
      const height = TOP + BOTTOM + 26 * Math.max(rows.length, 1);
      svg.replaceChildren();
      svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
      const across = scale(range(rows.flatMap((row) => [row.low, row.high, row.value]), chart.xrange), left, width - RIGHT);
      axes(svg, chart, width, height, across, null);
      if (chart.mark !== undefined) {
        const x = across.at(chart.mark);
        make("line", { x1: x, x2: x, y1: TOP, y2: height - BOTTOM, class: "mark" }, svg);
      }
      rows.forEach((row, place) => {
        const y = TOP + 26 * (place + 0.5);
        const colour = style(row.style).colour;
        const group = make("g", {}, svg);
        make("title", {}, group, `${row.name}: ${shown(row.value)} (${shown(row.low)} to ${shown(row.high)})`);
        make("rect", { x: 0, y: y - 13, width: width, height: 26, class: "row" }, group);
        make("text", { x: left - 10, y: y + 4, "text-anchor": "end" }, group, row.name.length * 6.6 > left ? `${row.name.slice(0, Math.floor(left / 6.6) - 2)}…` : row.name);
        make("line", { x1: across.at(row.low), x2: across.at(row.high), y1: y, y2: y, style: `stroke:${colour}`, "stroke-width": 3 }, group);
        make("circle", { cx: across.at(row.value), cy: y, r: 5, style: `fill:${colour}` }, group);
      });
    };
    redraws.push(draw);
    draw();
  };

  // Runs stay that have a chosen value of every override; variants, that have such a run.
  const filter = (place, runs) => {
    const keys = [...new Set(runs.flatMap((run) => Object.keys(run.overrides)))];
    const value = (run, key) => run.overrides[key] ?? "as it is";
    const left = new Map(keys.map((key) => [key, new Set()]));
    const apply = () => {
      const stay = runs.filter((run) => keys.every((key) => !left.get(key).has(value(run, key))));
      const variants = new Set(stay.map((run) => run.variant)), numbers = new Set(stay.map((run) => String(run.number)));
      hidden.clear();
      for (const run of runs) if (!variants.has(run.variant)) hidden.add(run.variant);
      for (const row of document.querySelectorAll("tr[data-variant]")) row.hidden = hidden.has(row.dataset.variant);
      for (const row of document.querySelectorAll("tr[data-run]")) row.hidden = !numbers.has(row.dataset.run);
      for (const draw of redraws) draw();
    };
    for (const key of keys) {
      const field = html("fieldset", "", place);
      html("legend", "", field, key);
      for (const one of [...new Set(runs.map((run) => value(run, key)))]) {
        const label = html("label", "", field);
        const box = html("input", "", label);
        box.type = "checkbox";
        box.checked = true;
        html("span", "", label, one);
        box.addEventListener("change", () => {
          box.checked ? left.get(key).delete(one) : left.get(key).add(one);
          apply();
        });
      }
    }
  };

  for (const figure of document.querySelectorAll("figure[data-chart]")) {
    const chart = data.charts[figure.dataset.chart];
    ({ lines, intervals })[chart.kind](figure, chart);
  }
  const place = document.getElementById("choice");
  if (place) filter(place, data.runs);
})();
