"use strict";
// Accuracy against a cost, drawn anew for every choice and width; the axis is a log one, but not for shares of captures.
// Names never lie on each other: on a wide page they stand in a column on the right, on a narrow one only those are
// written that find a free place.
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
  const svg = element("svg", {role: "group"}, box);
  const told = box.appendChild(document.createElement("p"));
  const short = v => v >= 1000 ? Math.round(v).toString() : parseFloat(v.toPrecision(3)).toString();
  const kinds = {published: " (published)", changed: " (published, other settings)", other: "", chip: ""};

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
    const about = data.groups[group.value], budget = about.budgets[cost.value], linear = data.linear[cost.value];
    const points = about.points.map(p => ({...p, cost: p.x[cost.value]})).filter(p => p.cost !== null && (linear || p.cost > 0) && p.y[0] !== null);
    const width = Math.max(280, box.clientWidth - 20), wide = width > 640, gap = 16;
    const height = Math.max(wide ? points.length * gap + 70 : 380, 460);
    svg.replaceChildren();
    svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
    svg.setAttribute("aria-label", `Accuracy against ${data.costs[cost.value]}, ${about.name}`);
    told.textContent = points.length ? hint(points, budget, about.left) : "This cost is unknown for all systems here.";
    if (!points.length) return;
    const left = 48, right = wide ? width * 0.64 : width - 10, top = 22, bottom = height - 46;
    const scale = linear ? v => v : Math.log10, margin = linear ? 1 : 0.1;
    const xs = [...points.map(p => p.cost), ...(budget ? [budget] : [])].map(scale);
    const ys = points.flatMap(p => p.y.filter(v => v !== null));  // no interval is cut off
    const x0 = Math.min(...xs) - margin, x1 = Math.max(...xs) + margin;
    const middle = (Math.max(...ys) + Math.min(...ys)) / 2, reach = Math.max(Math.max(...ys) - Math.min(...ys), 5) * 0.53;
    const X = v => left + (scale(v) - x0) / (x1 - x0) * (right - left);
    const Y = v => bottom - (v - middle + reach) / (2 * reach) * (bottom - top);
    axes(linear, x0, x1, middle - reach, middle + reach, X, Y, left, right, top, bottom);
    if (budget) {
      element("path", {class: "over", d: `M${X(budget)} ${top}H${right}V${bottom}H${X(budget)}z`}, svg);
      element("path", {class: "budget", d: `M${X(budget)} ${top}V${bottom}`}, svg);
      const end = X(budget) > (left + right) / 2;
      element("text", {x: X(budget) + (end ? -4 : 4), y: top - 7, "text-anchor": end ? "end" : "start"}, svg, `budget ${short(budget)}`);
    }
    const best = front(points);
    const line = best.map((p, i) => (i ? `H${X(p.cost)}V` : `M${X(p.cost)} `) + Y(p.y[0])).join("");
    for (const p of points) if (p.y[1] !== null)
      element("path", {class: p.out ? "bar out" : "bar", d: `M${X(p.cost)} ${Y(p.y[1])}V${Y(p.y[2])}`}, svg);
    element("path", {class: "front", d: line}, svg);
    const names = element("g", {"aria-hidden": "true"}, svg);
    const marks = [...points].sort((a, b) => a.cost - b.cost).map(p => mark(p, X(p.cost), Y(p.y[0])));
    marks.forEach((shape, i) => {  // one stop of the tab key; arrows go from mark to mark
      shape.setAttribute("tabindex", i ? -1 : 0);
      shape.addEventListener("keydown", event => {
        const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key];
        if (!step || !marks[i + step]) return;
        event.preventDefault();
        shape.setAttribute("tabindex", -1);
        marks[i + step].setAttribute("tabindex", 0);
        marks[i + step].focus();
      });
    });
    const order = [...points].sort((a, b) => b.y[0] - a.y[0]);
    if (wide) column(names, order, best, X, Y, right, width, top, bottom, gap);
    else free(names, order, best, X, Y, left, right, top, bottom);
  }

  function hint(points, budget, left) {
    const has = kind => points.some(p => p.kind === kind);
    const said = [has("published") && "filled circles: published systems run here", has("changed") && "hollow circles: published systems with other settings",
      has("other") && "squares: unpublished systems", has("chip") && "triangles: measured in C", "line and bold names: Pareto front",
      points.some(p => p.chosen) && "ring: the choice", budget && "shaded: over the budget", points.some(p => p.out) && "pale: ruled out by a budget"];
    const words = said.filter(Boolean).join("; ");
    return words[0].toUpperCase() + words.slice(1) + ". Bars are 95 % intervals over subjects. " +
      (left ? `${left} less accurate systems are not drawn. ` : "") + "To read the numbers of a mark, point at it, or move to it with the tab and arrow keys.";
  }

  const even = (low, high) => [1, 2, 5, 10, 20].find(s => (high - low) / s <= 8) || 25;

  function axes(linear, x0, x1, y0, y1, X, Y, left, right, top, bottom) {
    const ticks = [], steps = x1 - x0 > 2.2 ? [1] : right - left > 400 ? [1, 2, 5] : [1, 3], apart = even(x0, x1);
    if (linear) for (let v = Math.ceil(x0 / apart) * apart; v <= x1; v += apart) ticks.push(v);
    else for (let d = Math.floor(x0); d <= x1; d++) for (const m of steps) ticks.push(m * 10 ** d);
    for (const v of ticks.filter(t => X(t) >= left && X(t) <= right)) {
      element("path", {class: "grid", d: `M${X(v)} ${top}V${bottom}`}, svg);
      element("text", {x: X(v), y: bottom + 16, "text-anchor": "middle"}, svg, short(v));
    }
    const step = even(y0, y1);
    for (let v = Math.ceil(y0 / step) * step; v <= y1; v += step) {
      element("path", {class: "grid", d: `M${left} ${Y(v)}H${right}`}, svg);
      element("text", {x: left - 6, y: Y(v) + 4, "text-anchor": "end"}, svg, v + " %");
    }
    element("text", {x: (left + right) / 2, y: bottom + 36, "text-anchor": "middle"}, svg, right - left > 400 ? data.costs[cost.value] : data.costs[cost.value].split(/[:(]/)[0]);
  }

  function mark(p, x, y) {
    if (p.chosen) element("circle", {class: "ring", cx: x, cy: y, r: 11}, svg);
    const d = p.kind === "chip" ? `M${x - 5} ${y + 4.5}h10l-5 -9.5z` : p.kind !== "other" ? `M${x - 5} ${y}a5 5 0 1 0 10 0a5 5 0 1 0 -10 0` : `M${x - 4.5} ${y - 4.5}h9v9h-9z`;
    const shape = element("path", {class: p.kind + (p.out ? " out" : ""), d, role: "img"}, svg);
    const bounds = p.y[1] === null ? "" : ` [${p.y[1].toFixed(1)}, ${p.y[2].toFixed(1)}]`;
    const words = `${p.name}${kinds[p.kind]}: ${p.y[0].toFixed(1)}${bounds} %; ` +
      data.costs.map((c, i) => p.x[i] === null ? "" : `${short(p.x[i])} ${c}`).filter(Boolean).join("; ") + `; ${p.verdict}.`;
    shape.setAttribute("aria-label", words);
    for (const event of ["pointerenter", "focus", "click"]) shape.addEventListener(event, () => told.textContent = words);
    return shape;
  }

  function column(names, order, best, X, Y, right, width, top, bottom, gap) {
    const places = spread(order.map(p => Y(p.y[0])), gap, top + 6, bottom);
    order.forEach((p, i) => {
      element("path", {class: "tie", d: `M${X(p.cost) + 6} ${Y(p.y[0])}L${right + 12} ${places[i]}`}, names);
      const name = (p.chosen ? "choice: " : "") + p.name;
      const text = element("text", {x: right + 16, y: places[i] + 4, class: (best.includes(p) || p.chosen ? "best" : "") + (p.out ? " out" : "")}, names, name);
      for (let n = name.length; n > 3 && text.getComputedTextLength() > width - right - 18; n--)
        text.textContent = name.slice(0, n - 1) + "…";
    });
  }

  function free(names, order, best, X, Y, left, right, top, bottom) {
    const taken = order.map(p => [X(p.cost) - 6, Y(p.y[0]) - 6, X(p.cost) + 6, Y(p.y[0]) + 6]);
    const rank = p => p.chosen ? 0 : p.out ? 3 : best.includes(p) ? 1 : 2;
    for (const p of [...order].sort((a, b) => rank(a) - rank(b))) {
      const name = (p.chosen ? "choice: " : "") + p.name;
      const text = element("text", {class: (best.includes(p) || p.chosen ? "best" : "") + (p.out ? " out" : "")}, names, name);
      for (let n = name.length; n > 3 && text.getComputedTextLength() > (right - left) * 0.6; n--) text.textContent = name.slice(0, n - 1) + "…";
      const w = text.getComputedTextLength(), x = X(p.cost), y = Y(p.y[0]), off = p.chosen ? 14 : 8;
      const place = [[x + off, y + 4], [x - off - w, y + 4], [x - w / 2, y - off - 2], [x - w / 2, y + off + 11]].find(([a, b]) =>
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
