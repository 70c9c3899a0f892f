"use strict";
// Makes the tables of systems sort, filter, compare and download; without it, the page shows them as they are.
(() => {
  const state = {protocol: "", sort: "", filter: "", family: "", columns: "", pin: [], open: []};
  const groups = [], NEAR = 1e-4;  // points of accuracy that count as none, since scores are rounded

  const elementMaker = space => (tag, about = {}, ...inner) => {
    const node = document.createElementNS(space, tag);
    for (const [name, value] of Object.entries(about)) {
      if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
      else if (value !== false && value !== null) node.setAttribute(name, value === true ? "" : value);
    }
    node.append(...inner);
    return node;
  };
  const element = elementMaker("http://www.w3.org/1999/xhtml"), svgElement = elementMaker("http://www.w3.org/2000/svg");
  const signed = number => (number < 0 ? "" : "+") + number.toFixed(1);
  const several = (number, noun) => `${number} ${noun}${number === 1 ? "" : "s"}`;

  // ---- the address -------------------------------------------------------------------------------------------------
  function applyAddress() {
    const place = location.hash && !location.hash.includes("=");  // such as a footnote, or a section
    if (place && document.documentElement.dataset.live) return;
    const given = new URLSearchParams(place ? "" : location.hash.slice(1));
    for (const name of Object.keys(state)) state[name] = Array.isArray(state[name]) ? given.getAll(name) : given.get(name) || "";
    const tab = groups.find(group => group.key === state.protocol) || groups[0];
    tab.tab.checked = true;
    for (const group of groups) showGroup(group);
  }

  function changeState(part) {
    Object.assign(state, part);
    const given = new URLSearchParams();
    for (const [name, value] of Object.entries(state)) for (const one of [value].flat()) if (one) given.append(name, one);
    history.replaceState(null, "", given.size ? `#${given}` : location.href.split("#")[0]);
    for (const group of groups) showGroup(group);
  }

  const toggle = (list, one) => list.includes(one) ? list.filter(other => other !== one) : [...list, one];

  // ---- the table ---------------------------------------------------------------------------------------------------
  const number = text => /^[a-z]/i.test(text) ? NaN : parseFloat((/-?\d[\d ]*\.?\d*/.exec(text) || [""])[0].replaceAll(" ", ""));

  function compareRows(group, column, falls) {
    const place = group.columns.indexOf(column), sign = falls ? -1 : 1, words = column.key === "system";
    return (a, b) => {
      const [one, two] = [a, b].map(row => row.cells[place]);
      const [x, y] = [one, two].map(number);
      if (words || isNaN(x) && isNaN(y)) return sign * one.localeCompare(two);
      return isNaN(x) || isNaN(y) ? isNaN(x) - isNaN(y) : sign * (x - y);
    };
  }

  function visibleRows(group) {
    const column = group.columns.find(c => c.key === state.sort.replace(/^-/, ""));
    const words = state.filter.toLowerCase().split(" ").filter(Boolean);
    const rows = group.rows.filter(row => words.every(word => row.name.toLowerCase().includes(word)) && (!state.family || row.family === state.family));
    return column ? rows.sort(compareRows(group, column, state.sort[0] === "-")) : rows;
  }

  const shownColumns = group => state.columns ? group.columns.filter(c => c.key === "system" || state.columns.split(",").includes(c.key)) : group.columns.filter(c => c.shown);

  const intervalEnds = text => { const [value, low = value, high = value] = (text.match(/[\d.]+/g) || []).map(Number); return [low, value, high]; };

  function setScale(group) {  // of the intervals: the place of a value, and a heading with round values
    const place = group.columns.findIndex(column => column.key === "accuracy"), values = group.rows.flatMap(row => intervalEnds(row.cells[place]));
    const low = Math.min(...values), high = Math.max(...values);
    group.at = value => `${(4 + 92 * (value - low) / (high - low || 1)).toFixed(1)}%`;  // a dot at an end is not cut off
    const step = [50, 25, 20, 10, 5, 2].find(size => Math.floor(high / size) - Math.ceil(low / size) >= 2) || 1;
    const ticks = [...Array(101).keys()].filter(value => value % step === 0 && value >= low && value <= high).map(value => [value, group.at(value)]);
    const marks = ticks.flatMap(([value, x]) => [svgElement("line", {x1: x, x2: x, y1: "85%", y2: "100%"}), svgElement("text", {x, y: "70%"}, value)]);
    group.axis = element("th", {scope: "col", class: "axis"}, svgElement("svg", {class: "bar", role: "img", "aria-label": "scale of the 95 % intervals"}, ...marks));
  }

  const drawBar = (group, [low, value, high]) => element("td", {}, svgElement("svg", {class: "bar", "aria-hidden": "true"},
    svgElement("line", {x1: group.at(low), x2: group.at(high), y1: "50%", y2: "50%"}), svgElement("circle", {cx: group.at(value), cy: "50%", r: 4})));

  function makeCells(group, columns, texts, name, intervals) {
    return columns.flatMap(column => {
      const text = texts[group.columns.indexOf(column)];
      const cell = column.key === "system" ? element("th", {scope: "row"}, ...name(text)) : element("td", {}, text);
      return column.key === "accuracy" ? [cell, intervals ? drawBar(group, intervalEnds(text)) : element("td", {}, svgElement("svg", {class: "bar"}))] : [cell];
    });
  }

  function makeRows(group, columns, row) {
    const opened = state.open.includes(row.name), pinned = state.pin.includes(row.name);
    const marks = row.marks.map(mark => element("sup", {}, element("a", {href: `#${group.notes}${mark}`}, `${mark} `)));
    const name = text => [
      element("input", {type: "checkbox", "data-pin": row.name, "aria-label": `compare ${row.name}`, onchange: () => changeState({pin: toggle(state.pin, row.name)})}),
      ` ${text}${row.chosen ? " (chosen)" : ""}`, ...marks,
      ...row.seeds.length ? [" ", element("button", {class: "seeds", "data-open": row.name, "aria-expanded": String(opened), onclick: () => changeState({open: toggle(state.open, row.name)})}, several(row.seeds.length, "seed"))] : [],
    ];
    const first = element("tr", {class: row.chosen ? "chosen" : null}, ...makeCells(group, columns, row.cells, name, true));
    first.querySelector("input").checked = pinned;
    return [first, ...opened ? row.seeds.map(texts => element("tr", {class: "seed"}, ...makeCells(group, columns, texts, text => [text]))) : []];
  }

  function showGroup(group) {
    const columns = shownColumns(group), rows = visibleRows(group), focused = document.activeElement?.dataset || {};
    const heads = columns.flatMap(column => {
      const down = `-${column.key}` === state.sort, up = column.key === state.sort;
      const next = column.up ? (up ? `-${column.key}` : column.key) : (down ? column.key : `-${column.key}`);
      const button = element("button", {"data-sort": column.key, onclick: () => changeState({sort: next})}, column.name);
      const head = element("th", {scope: "col", "aria-sort": up ? "ascending" : down ? "descending" : "none"}, button);
      return column.key === "accuracy" ? [head, group.axis] : [head];
    });
    group.head.replaceChildren(...heads);
    group.body.replaceChildren(...rows.flatMap(row => makeRows(group, columns, row)));
    for (const name of ["sort", "pin", "open"]) {
      if (name in focused) group.table.querySelector(`[data-${name}="${CSS.escape(focused[name])}"]`)?.focus();
    }
    group.count.textContent = `${rows.length} of ${several(group.rows.length, "system")}`;
    for (const [input, value] of [[group.filter, state.filter], [group.family, state.family]]) if (input.value !== value) input.value = value;
    for (const box of group.boxes) box.checked = columns.some(column => column.key === box.value);
    for (const mark of group.pane.querySelectorAll(".mark")) mark.classList.toggle("pinned", state.pin.includes(mark.querySelector("text").textContent));
    showPair(group);
  }

  function downloadCsv(group) {
    const harmless = text => /^[=+\-@\t\r]/.test(text) && isNaN(Number(text)) && text !== "-" ? `'${text}` : text;
    const quoted = text => /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
    const columns = shownColumns(group), kept = texts => columns.map(column => texts[group.columns.indexOf(column)]);
    const rows = visibleRows(group).flatMap(row => [kept(row.cells), ...state.open.includes(row.name) ? row.seeds.map(kept) : []]);
    const text = [columns.map(column => column.name), ...rows].map(row => row.map(cell => quoted(harmless(cell))).join(",")).join("\n");
    const link = element("a", {href: URL.createObjectURL(new Blob([`${text}\n`], {type: "text/csv"})), download: `${group.key}.csv`});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  // ---- two systems -------------------------------------------------------------------------------------------------
  function pairTest(group, one, two) {  // of the first minus the second system; null where the page has no test
    const test = group.pairs.find(([a, b]) => a === one.place && b === two.place || a === two.place && b === one.place);
    if (!test || test[4] === null) return null;
    const [first, , low, high, p] = test;
    return first === one.place ? {low, high, p} : {low: -high, high: -low, p};
  }

  const makeTable = (caption, heads, rows) => element("div", {class: "scroll", tabindex: "0", role: "group", "aria-label": caption}, element("table", {}, element("caption", {}, caption),
    element("thead", {}, element("tr", {}, ...heads.map(head => element("th", {scope: "col"}, head)))),
    element("tbody", {}, ...rows.map(([first, ...rest]) => element("tr", {}, element("th", {scope: "row"}, first), ...rest.map(cell => element("td", {}, cell)))))));

  function showPair(group) {
    const [one, two] = state.pin.map(name => group.rows.find(row => row.name === name)).filter(Boolean).slice(-2);
    group.pair.replaceChildren();
    if (!two) return void group.pair.append(...one ? [element("p", {}, `Tick another system to compare it with ${one.name}.`)] : []);
    const shared = group.people.flatMap((_, i) => one.scores[i] === null || two.scores[i] === null ? [] : [i]);
    const differences = shared.map(i => one.scores[i] - two.scores[i]);
    const mean = differences.reduce((a, b) => a + b, 0) / differences.length, test = pairTest(group, one, two);
    const p = test && (test.p < 0.001 ? "< 0.001" : `= ${test.p.toFixed(3)}`), people = several(differences.length, "subject");
    const words = test ? `95 % interval [${signed(test.low)}, ${signed(test.high)}], p ${p} (both by the paired two-sided Wilcoxon test over ${people}; not corrected).` : differences.length < 6 ? `${people}: too few for a test.` : "The page has no test of these two; it tests whole captures of the most accurate systems.";
    const named = sign => shared.filter((_, i) => sign * differences[i] > NEAR).map(i => group.people[i]).sort((a, b) => a.localeCompare(b, undefined, {numeric: true}));
    const listed = names => `${several(names.length, "subject")}${names.length ? ` (${names.join(", ")})` : ""}`;
    group.pair.append(element("h3", {}, `${one.name} and ${two.name}`),
      element("p", {"data-pair": ""}, `${one.name} is ${Math.abs(mean).toFixed(1)} points ${mean < 0 ? "less" : "more"} accurate than ${two.name}. ${words}`),
      element("p", {}, `${one.name} is more accurate for ${listed(named(1))}, ${two.name} for ${listed(named(-1))}.`),
      makeTable("Measures side by side", ["measure", one.name, two.name], group.columns.flatMap((c, i) => c.key === "system" ? [] : [[c.name, one.cells[i] || "-", two.cells[i] || "-"]])));
    if (!one.hits || !two.hits) return void group.pair.append(element("p", {}, "The page has no single captures of both systems."));
    const only = (a, b) => group.captures.filter((_, i) => a.hits[i] === "1" && b.hits[i] === "0");
    const [first, second] = [only(one, two), only(two, one)];
    const share = (row, places) => 100 * places.filter(i => row.hits[i] === "1").length / places.length;
    const gestures = group.gestures.map((gesture, g) => {
      const places = group.true.flatMap((true_, i) => true_ === g ? [i] : []), [a, b] = [share(one, places), share(two, places)];
      const alone = (x, y) => places.filter(i => x.hits[i] === "1" && y.hits[i] === "0").length;
      return [gesture, String(places.length), a.toFixed(1), b.toFixed(1), signed(a - b), String(alone(one, two)), String(alone(two, one))];
    }).filter(row => row[1] !== "0").sort((a, b) => Math.abs(b[4]) - Math.abs(a[4]));
    group.pair.append(makeTable("Correctly classified captures by gesture, in percent, of the lowest seed; gestures with the largest difference first",
      ["gesture", "captures", one.name, two.name, "difference", `only ${one.name}`, `only ${two.name}`], gestures),
    ...[[one, first], [two, second]].map(([row, captures]) => element("details", {}, element("summary", {}, `Only ${row.name} classifies ${several(captures.length, "capture")} correctly`), element("p", {}, captures.join(", ")))));
  }

  // ---- the chart, and the beginning --------------------------------------------------------------------------------
  function enableChart(figure) {
    const marks = [...figure.querySelectorAll(".mark")], about = figure.querySelector(".about");
    for (const mark of marks) {  // what the page leaves out of most marks
      mark.setAttribute("role", "img");
      mark.setAttribute("tabindex", mark === marks[0] ? "0" : "-1");
      const name = mark.querySelector("title").textContent.replace(/: [\d.]+( \[[^\]]*\])? %, .*/, ""), end = parseFloat(mark.getAttribute("x")) > 50;
      if (!mark.querySelector("text")) mark.append(svgElement("text", {x: end ? -7 : 7, y: -8, "text-anchor": end ? "end" : "start"}, name));
    }
    const tell = event => { const mark = event.target.closest(".mark"); if (mark) about.textContent = mark.querySelector("title").textContent; };
    for (const name of ["pointerover", "focusin", "click"]) figure.addEventListener(name, tell);
    figure.addEventListener("keydown", event => {
      const step = {ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1}[event.key], place = marks.indexOf(event.target);
      if (!step || place < 0) return;
      event.preventDefault();
      const next = marks[(place + step + marks.length) % marks.length];
      event.target.setAttribute("tabindex", "-1");
      next.setAttribute("tabindex", "0");
      next.focus();
    });
  }

  function makeTools(group) {
    group.filter = element("input", {type: "search", placeholder: "filter systems", "aria-label": "filter systems", oninput: () => changeState({filter: group.filter.value})});
    const families = [...new Set(group.rows.map(row => row.family))].sort();
    group.family = element("select", {"aria-label": "family", onchange: () => changeState({family: group.family.value})}, element("option", {value: ""}, "all families"), ...families.map(name => element("option", {value: name}, name)));
    group.boxes = group.columns.filter(c => c.key !== "system").map(c => element("input", {type: "checkbox", value: c.key, onchange: () => changeState({columns: group.boxes.filter(box => box.checked).map(box => box.value).join(",") || "system"})}));
    const choice = group.boxes.map((box, i) => element("label", {}, box, ` ${group.columns.filter(c => c.key !== "system")[i].name}`));
    group.count = element("span", {role: "status"});
    return element("div", {class: "tools"}, group.filter, group.family, element("details", {}, element("summary", {}, "columns"), ...choice),
      element("button", {onclick: () => downloadCsv(group)}, "download CSV"), element("button", {onclick: () => changeState({sort: "", filter: "", family: "", columns: "", pin: [], open: []})}, "reset"), group.count);
  }

  function unpackRows(data) {  // which stand in columns
    const of = (columns, i) => columns.map(column => column[i]);
    return data.name.map((name, i, _, first = data.counts.slice(0, i).reduce((a, b) => a + b, 0)) => ({
      name, place: i, family: data.family[i], chosen: data.chosen.includes(i), marks: data.marks[i], cells: of(data.cells, i), scores: of(data.scores, i),
      hits: data.hits[i], seeds: Array.from({length: data.counts[i]}, (_, seed) => of(data.seeds, first + seed)),
    }));
  }

  async function startTable(live) {
    const packed = live.querySelector("script[data-notes]"), bytes = Uint8Array.from(atob(packed.textContent.trim()), c => c.charCodeAt(0));
    const data = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).json();
    const pane = live.closest(".pane"), table = live.querySelector("table"), pair = element("section", {class: "pair", "aria-live": "polite"});
    const group = {...data, rows: unpackRows(data), pane, table, pair, notes: packed.dataset.notes, head: table.tHead.rows[0], body: table.tBodies[0]};
    group.captures = data.captures.map((sum => step => sum += step)(0));  // each is stored as its distance from the last
    setScale(group);
    group.tab = document.getElementById(pane.previousElementSibling.htmlFor);
    group.tab.addEventListener("change", () => changeState({protocol: group.key === groups[0].key ? "" : group.key}));
    live.prepend(makeTools(group));
    live.append(pair);
    return group;
  }

  document.querySelectorAll(".charts figure").forEach(enableChart);
  Promise.all([...document.querySelectorAll(".live")].map(startTable)).then(made => {
    groups.push(...made);
    if (groups.length) applyAddress();
    addEventListener("hashchange", applyAddress);
    document.documentElement.dataset.live = "yes";
  });
})();
