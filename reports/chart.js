"use strict";
// Accuracy against a cost on a log axis, drawn anew for every choice and width. Names never lie on each other: on a wide
// page they stand in a column on the right, on a narrow one only those are written that find a free place.
(() => {
  const source = document.getElementById("chart-data");
  const box = document.getElementById("chart");
  if (!source || !box) return;
  const data = JSON.parse(source.textContent);
  const element = (name, attributes, parent, text) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [k, v] of Object.entries(attributes)) made.setAttribute(k, v);
    if (text !== undefined) made.textContent = text;
    if (parent) parent.append(made);
    return made;
  };
  const chooser = (words, names) => {
    const label = document.createElement("label");
    const select = document.createElement("select");
    names.forEach((n, i) => select.append(new Option(n, i)));
    label.append(words + " ", select);
    box.append(label);
    return select;
  };
  const group = chooser("Captures and protocol", data.groups.map(g => g.name));
  const cost = chooser("Cost", data.costs);
  const svg = element("svg", {role: "img"}, box);
  const told = box.appendChild(document.createElement("output"));
  const short = v => v >= 1000 ? Math.round(v).toString() : parseFloat(v.toPrecision(3)).toString();
  const hint = "Filled circles are published systems run here, hollow circles these with other settings, squares others; the line is the Pareto front. " +
    "Point at a mark, or reach it with the tab key, to read its numbers.";

  const front = points => {
    const kept = [];
    for (const p of [...points].sort((a, b) => a.cost - b.cost || b.y[0] - a.y[0]))
      if (!kept.length || p.y[0] > kept[kept.length - 1].y[0]) kept.push(p);
    return kept;
  };
  const spread = (wanted, gap, low, high) => {  // rising places at least gap apart, as the names of the figures
    const at = [];
    wanted.forEach((w, i) => at.push(Math.max(w, i ? at[i - 1] + gap : low)));
    for (let i = at.length - 1; i >= 0; i--) at[i] = Math.min(at[i], i === at.length - 1 ? high : at[i + 1] - gap);
    return at;
  };

  function draw() {
    const all = data.groups[group.value].points;
    const points = all.map(p => ({...p, cost: p.x[cost.value]})).filter(p => p.cost > 0 && p.y[0] !== null);
    const width = Math.max(280, box.clientWidth - 20), wide = width > 640, gap = 15;
    const height = Math.max(wide ? points.length * gap + 70 : 380, 380);
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("aria-label", `Accuracy against ${data.costs[cost.value]}, ${data.groups[group.value].name}`);
    told.textContent = points.length ? hint : "This cost is not known for any system here.";
    if (!points.length) return;
    const left = 44, right = wide ? width * 0.66 : width - 10, top = 12, bottom = height - 44;
    const logs = points.map(p => Math.log10(p.cost)), ys = points.map(p => p.y[0]);
    const x0 = Math.min(...logs) - 0.1, x1 = Math.max(...logs) + 0.1;
    const middle = (Math.max(...ys) + Math.min(...ys)) / 2, reach = Math.max(Math.max(...ys) - Math.min(...ys), 5) * 0.56;
    const X = v => left + (Math.log10(v) - x0) / (x1 - x0) * (right - left);
    const Y = v => bottom - (v - middle + reach) / (2 * reach) * (bottom - top);
    const inside = v => Math.min(bottom, Math.max(top, Y(v)));
    axes(x0, x1, middle - reach, middle + reach, X, Y, left, right, top, bottom);

    const best = front(points);
    for (const p of points) if (p.y[1] !== null)
      element("path", {class: "bar", d: `M${X(p.cost)} ${inside(p.y[1])}V${inside(p.y[2])}`}, svg);
    element("path", {class: "front", d: best.map((p, i) =>
      i ? `H${X(p.cost)}V${Y(p.y[0])}` : `M${X(p.cost)} ${Y(p.y[0])}`).join("")}, svg);
    const names = element("g", {}, svg);
    for (const p of points) mark(p, X(p.cost), Y(p.y[0]));
    const order = [...points].sort((a, b) => b.y[0] - a.y[0]);
    if (wide) column(names, order, best, X, Y, right, width, top, bottom, gap);
    else free(names, order, best, X, Y, left, right, top, bottom);
  }

  function axes(x0, x1, y0, y1, X, Y, left, right, top, bottom) {
    const ticks = [];
    for (let d = Math.floor(x0); d <= x1; d++) for (const m of x1 - x0 < 2.2 ? [1, 2, 5] : [1]) ticks.push(m * 10 ** d);
    for (const v of ticks.filter(t => Math.log10(t) >= x0 && Math.log10(t) <= x1)) {
      element("path", {class: "grid", d: `M${X(v)} ${top}V${bottom}`}, svg);
      element("text", {x: X(v), y: bottom + 16, "text-anchor": "middle"}, svg, short(v));
    }
    const step = [1, 2, 5, 10, 20].find(s => (y1 - y0) / s <= 8) || 25;
    for (let v = Math.ceil(y0 / step) * step; v <= y1; v += step) {
      element("path", {class: "grid", d: `M${left} ${Y(v)}H${right}`}, svg);
      element("text", {x: left - 6, y: Y(v) + 4, "text-anchor": "end"}, svg, v + " %");
    }
    element("text", {x: (left + right) / 2, y: bottom + 36, "text-anchor": "middle"}, svg, data.costs[cost.value]);
  }

  function mark(p, x, y) {
    const d = p.kind === "chip" ? `M${x - 5} ${y + 4.5}h10l-5 -9.5z` : p.kind !== "other" ? `M${x - 5} ${y}a5 5 0 1 0 10 0a5 5 0 1 0 -10 0` : `M${x - 4.5} ${y - 4.5}h9v9h-9z`;
    const shape = element("path", {class: p.kind, d, tabindex: 0}, svg);
    const bounds = p.y[1] === null ? "" : ` [${p.y[1].toFixed(1)}, ${p.y[2].toFixed(1)}]`;
    const words = `${p.name}${{published: " (published)", changed: " (published, other settings)", other: "", chip: ""}[p.kind]}: ${p.y[0].toFixed(1)}${bounds} %; ` +
      data.costs.map((c, i) => p.x[i] === null ? "" : `${short(p.x[i])} ${c}`).filter(Boolean).join("; ");
    shape.setAttribute("aria-label", words);
    for (const event of ["pointerenter", "focus", "click"]) shape.addEventListener(event, () => told.textContent = words);
  }

  function column(names, order, best, X, Y, right, width, top, bottom, gap) {
    const places = spread(order.map(p => Y(p.y[0])), gap, top + 6, bottom);
    order.forEach((p, i) => {
      element("path", {class: "tie", d: `M${X(p.cost) + 6} ${Y(p.y[0])}L${right + 12} ${places[i]}`}, names);
      const text = element("text", {x: right + 16, y: places[i] + 4, class: best.includes(p) ? "best" : ""}, names, p.name);
      for (let n = p.name.length; n > 3 && text.getComputedTextLength() > width - right - 18; n--)
        text.textContent = p.name.slice(0, n - 1) + "…";
    });
  }

  function free(names, order, best, X, Y, left, right, top, bottom) {
    const taken = order.map(p => [X(p.cost) - 6, Y(p.y[0]) - 6, X(p.cost) + 6, Y(p.y[0]) + 6]);
    for (const p of [...best, ...order.filter(q => !best.includes(q))]) {
      const text = element("text", {class: best.includes(p) ? "best" : ""}, names, p.name);
      const w = text.getComputedTextLength(), x = X(p.cost), y = Y(p.y[0]);
      const place = [[x + 8, y + 4], [x - 8 - w, y + 4], [x - w / 2, y - 9], [x - w / 2, y + 18]].find(([a, b]) =>
        a >= left && a + w <= right && b - 10 >= top && b + 3 <= bottom &&
        taken.every(t => a + w < t[0] || a > t[2] || b + 3 < t[1] || b - 10 > t[3]));
      if (!place) { text.remove(); continue; }
      text.setAttribute("x", place[0]);
      text.setAttribute("y", place[1]);
      taken.push([place[0], place[1] - 10, place[0] + w, place[1] + 3]);
    }
  }

  let last = 0;
  for (const select of [group, cost]) select.addEventListener("change", draw);
  new ResizeObserver(() => { if (box.clientWidth !== last) { last = box.clientWidth; draw(); } }).observe(box);
  addEventListener("beforeprint", draw);
})();
