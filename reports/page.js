"use strict";
// Makes the tables of systems sort, filter, compare and download; without it, the page shows them as they are.
(() => {
  const state = {protocol: "", sort: "", filter: "", family: "", columns: "", pin: [], open: []};
  const groups = [];

  const make = (tag, about = {}, ...inner) => {
    const element = document.createElement(tag);
    for (const [name, value] of Object.entries(about)) {
      if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
      else if (value !== false && value !== null) element.setAttribute(name, value === true ? "" : value);
    }
    element.append(...inner);
    return element;
  };
  const drawn = (tag, about) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
    for (const [name, value] of Object.entries(about)) element.setAttribute(name, value);
    return element;
  };
  const signed = number => (number < 0 ? "" : "+") + number.toFixed(1);
  const several = (number, noun) => `${number} ${noun}${number === 1 ? "" : "s"}`;

  // ---- the address -------------------------------------------------------------------------------------------------

  function read() {
    if (location.hash && !location.hash.includes("=")) return;  // a place of the page
    const given = new URLSearchParams(location.hash.slice(1));
    for (const name of Object.keys(state)) state[name] = Array.isArray(state[name]) ? given.getAll(name) : given.get(name) || "";
    const tab = groups.find(group => group.key === state.protocol) || groups[0];
    tab.tab.checked = true;
    for (const group of groups) show(group);
  }

  function changed(part) {
    Object.assign(state, part);
    const given = new URLSearchParams();
    for (const [name, value] of Object.entries(state)) for (const one of [value].flat()) if (one) given.append(name, one);
    history.replaceState(null, "", given.size ? `#${given}` : location.href.split("#")[0]);
    for (const group of groups) show(group);
  }

  const toggled = (list, one) => list.includes(one) ? list.filter(other => other !== one) : [...list, one];

  // ---- the table ---------------------------------------------------------------------------------------------------

  const number = text => {
    const found = /-?\d[\d ]*\.?\d*/.exec(text);
    return found && !/^[a-z]/i.test(text) ? parseFloat(found[0].replaceAll(" ", "")) : NaN;
  };

  function order(group, column, falls) {
    const place = group.columns.indexOf(column), sign = falls ? -1 : 1, words = column.key === "system";
    return (a, b) => {
      const [one, two] = [a, b].map(row => row.cells[place]);
      if (words) return sign * one.localeCompare(two);
      const [x, y] = [one, two].map(number);
      return isNaN(x) || isNaN(y) ? isNaN(x) - isNaN(y) : sign * (x - y);
    };
  }

  function visible(group) {
    const column = group.columns.find(c => c.key === state.sort.replace(/^-/, ""));
    const words = state.filter.toLowerCase().split(" ").filter(Boolean);
    const rows = group.rows.filter(row => words.every(word => row.name.toLowerCase().includes(word)) && (!state.family || row.family === state.family));
    return column ? rows.sort(order(group, column, state.sort[0] === "-")) : rows;
  }

  const chosenColumns = group => state.columns ? group.columns.filter(c => c.key === "system" || state.columns.split(",").includes(c.key)) : group.columns.filter(c => c.shown);

  function bar([low, value, high]) {
    const svg = drawn("svg", {class: "bar", "aria-hidden": "true"});
    svg.append(drawn("line", {x1: `${low}%`, x2: `${high}%`, y1: "50%", y2: "50%"}), drawn("circle", {cx: `${value}%`, cy: "50%", r: 4}));
    return make("td", {}, svg);
  }

  function cells(group, columns, texts, name, ends) {
    return columns.flatMap(column => {
      const text = texts[group.columns.indexOf(column)];
      const cell = column.key === "system" ? make("th", {scope: "row"}, ...name(text)) : make("td", {}, text);
      return column.key === "accuracy" ? [cell, ends ? bar(ends) : make("td", {}, drawn("svg", {class: "bar"}))] : [cell];
    });
  }

  function lines(group, columns, row) {
    const opened = state.open.includes(row.name), pinned = state.pin.includes(row.name);
    const marks = row.marks.map(mark => make("sup", {}, make("a", {href: `#${group.notes}${mark}`}, `${mark} `)));
    const name = text => [
      make("input", {type: "checkbox", "data-pin": row.name, "aria-label": `compare ${row.name}`, onchange: () => changed({pin: toggled(state.pin, row.name)})}),
      ` ${text}${row.chosen ? " (chosen)" : ""}`, ...marks,
      ...row.seeds.length ? [" ", make("button", {class: "seeds", "data-open": row.name, "aria-expanded": String(opened), onclick: () => changed({open: toggled(state.open, row.name)})}, several(row.seeds.length, "seed"))] : [],
    ];
    const first = make("tr", {class: row.chosen ? "chosen" : null}, ...cells(group, columns, row.cells, name, row.bar));
    first.querySelector("input").checked = pinned;
    return [first, ...opened ? row.seeds.map(texts => make("tr", {class: "seed"}, ...cells(group, columns, texts, text => [text]))) : []];
  }

  function show(group) {
    const columns = chosenColumns(group), rows = visible(group), focused = document.activeElement?.dataset || {};
    const heads = columns.flatMap(column => {
      const down = `-${column.key}` === state.sort, up = column.key === state.sort;
      const next = column.up ? (up ? `-${column.key}` : column.key) : (down ? column.key : `-${column.key}`);
      const button = make("button", {"data-sort": column.key, onclick: () => changed({sort: next})}, column.name);
      const head = make("th", {scope: "col", "aria-sort": up ? "ascending" : down ? "descending" : "none"}, button);
      return column.key === "accuracy" ? [head, group.axis] : [head];
    });
    group.head.replaceChildren(...heads);
    group.body.replaceChildren(...rows.flatMap(row => lines(group, columns, row)));
    for (const name of ["sort", "pin", "open"]) {
      if (name in focused) group.table.querySelector(`[data-${name}="${CSS.escape(focused[name])}"]`)?.focus();
    }
    group.count.textContent = `${rows.length} of ${several(group.rows.length, "system")}`;
    for (const [input, value] of [[group.filter, state.filter], [group.family, state.family]]) if (input.value !== value) input.value = value;
    for (const box of group.boxes) box.checked = columns.some(column => column.key === box.value);
    for (const mark of group.pane.querySelectorAll(".mark")) mark.classList.toggle("pinned", state.pin.includes(mark.querySelector("text").textContent));
    compare(group);
  }

  function download(group) {
    const harmless = text => /^[=+\-@\t\r]/.test(text) && isNaN(Number(text)) && text !== "-" ? `'${text}` : text;
    const quoted = text => /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
    const columns = chosenColumns(group), kept = texts => columns.map(column => texts[group.columns.indexOf(column)]);
    const rows = visible(group).flatMap(row => [kept(row.cells), ...state.open.includes(row.name) ? row.seeds.map(kept) : []]);
    const text = [columns.map(column => column.name), ...rows].map(row => row.map(cell => quoted(harmless(cell))).join(",")).join("\n");
    const link = make("a", {href: URL.createObjectURL(new Blob([`${text}\n`], {type: "text/csv"})), download: `${group.key}.csv`});
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  }

  // ---- two systems -------------------------------------------------------------------------------------------------

  function sums(ranks) {  // probability of each sum of ranks, if each of them counts or not with equal odds
    let odds = [1];
    for (const rank of ranks) {
      const more = Array(odds.length + rank).fill(0);
      odds.forEach((one, i) => { more[i] += one / 2; more[i + rank] += one / 2; });
      odds = more;
    }
    return odds;
  }

  function tested(differences) {  // Wilcoxon's signed rank test and the shifts that it does not reject
    const moved = differences.filter(d => d !== 0), sizes = moved.map(Math.abs);
    if (differences.length < 6) return null;
    const doubled = sizes.map(size => sizes.filter(other => other < size).length * 2 + sizes.filter(other => other === size).length + 1);
    const gained = doubled.reduce((sum, rank, i) => sum + (moved[i] > 0 ? rank : 0), 0), all = doubled.reduce((a, b) => a + b, 0);
    const p = moved.length < 2 ? 1 : Math.min(1, 2 * sums(doubled).slice(0, Math.min(gained, all - gained) + 1).reduce((a, b) => a + b, 0));
    const means = differences.flatMap((a, i) => differences.slice(i).map(b => (a + b) / 2)).sort((a, b) => a - b);
    let rejected = 0, odds = 0;
    for (const one of sums(differences.map((_, i) => i + 1))) if (2 * (odds += one) <= 0.05) rejected++;
    return {p, low: means[rejected - 1], high: means[means.length - rejected]};
  }

  const grid = (caption, heads, rows) => make("div", {class: "scroll", tabindex: "0", role: "group", "aria-label": caption}, make("table", {}, make("caption", {}, caption),
    make("thead", {}, make("tr", {}, ...heads.map(head => make("th", {scope: "col"}, head)))),
    make("tbody", {}, ...rows.map(([first, ...rest]) => make("tr", {}, make("th", {scope: "row"}, first), ...rest.map(cell => make("td", {}, cell)))))));

  function compare(group) {
    const [one, two] = state.pin.map(name => group.rows.find(row => row.name === name)).filter(Boolean).slice(-2);
    group.pair.replaceChildren();
    if (!two) return void group.pair.append(...one ? [make("p", {}, `Tick another system to compare it with ${one.name}.`)] : []);
    const differences = one.scores.map((score, i) => Math.round((score - two.scores[i]) * 1e6) / 1e6);
    const mean = differences.reduce((a, b) => a + b, 0) / differences.length, test = tested(differences);
    const p = test && (test.p < 0.001 ? "< 0.001" : `= ${test.p.toFixed(3)}`), people = several(differences.length, "subject");
    const words = test ? `95 % interval [${signed(test.low)}, ${signed(test.high)}], p ${p} (both by the paired two-sided Wilcoxon test over ${people}; one test, not corrected).` : `${people}: too few for a test.`;
    const named = sign => group.people.filter((_, i) => sign * differences[i] > 0), gain = named(1), lose = named(-1);
    const listed = names => names.length ? ` (${names.join(", ")})` : "";
    group.pair.append(make("h3", {}, `${one.name} and ${two.name}`),
      make("p", {"data-pair": ""}, `${one.name} is ${Math.abs(mean).toFixed(1)} points ${mean < 0 ? "less" : "more"} accurate than ${two.name}. ${words}`),
      make("p", {}, `${several(gain.length, "subject")} more accurate with ${one.name}${listed(gain)}, ${lose.length} with ${two.name}${listed(lose)}.`),
      grid("Measures side by side", ["measure", one.name, two.name], group.columns.flatMap((c, i) => c.key === "system" ? [] : [[c.name, one.cells[i], two.cells[i]]])));
    if (!one.hits || !two.hits) return void group.pair.append(make("p", {}, "The page has no single captures of both systems."));
    const only = (a, b) => group.captures.filter((_, i) => a.hits[i] === "1" && b.hits[i] === "0");
    const [first, second] = [only(one, two), only(two, one)];
    const share = (row, places) => 100 * places.filter(i => row.hits[i] === "1").length / places.length;
    const gestures = group.gestures.map((gesture, g) => {
      const places = group.true.flatMap((true_, i) => true_ === g ? [i] : []), [a, b] = [share(one, places), share(two, places)];
      const alone = (x, y) => places.filter(i => x.hits[i] === "1" && y.hits[i] === "0").length;
      return [gesture, String(places.length), a.toFixed(1), b.toFixed(1), signed(a - b), String(alone(one, two)), String(alone(two, one))];
    }).filter(row => row[1] !== "0").sort((a, b) => Math.abs(b[4]) - Math.abs(a[4]));
    group.pair.append(grid("Correctly classified captures by gesture, in percent, of the lowest seed; gestures with the largest difference first",
      ["gesture", "captures", one.name, two.name, "difference", `only ${one.name}`, `only ${two.name}`], gestures),
    ...[[one, first], [two, second]].map(([row, captures]) => make("details", {}, make("summary", {}, `Only ${row.name} classifies ${several(captures.length, "capture")} correctly`), make("p", {}, captures.join(", ")))));
  }

  // ---- the chart, and the beginning --------------------------------------------------------------------------------

  function chart(figure) {
    const marks = [...figure.querySelectorAll(".mark")], about = figure.querySelector(".about");
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

  function tools(group) {
    group.filter = make("input", {type: "search", placeholder: "filter systems", "aria-label": "filter systems", oninput: () => changed({filter: group.filter.value})});
    const families = [...new Set(group.rows.map(row => row.family))].sort();
    group.family = make("select", {"aria-label": "family", onchange: () => changed({family: group.family.value})}, make("option", {value: ""}, "all families"), ...families.map(name => make("option", {value: name}, name)));
    group.boxes = group.columns.filter(c => c.key !== "system").map(c => make("input", {type: "checkbox", value: c.key, onchange: () => changed({columns: group.boxes.filter(box => box.checked).map(box => box.value).join(",") || "system"})}));
    const choice = group.boxes.map((box, i) => make("label", {}, box, ` ${group.columns.filter(c => c.key !== "system")[i].name}`));
    group.count = make("span", {role: "status"});
    return make("div", {class: "tools"}, group.filter, group.family, make("details", {}, make("summary", {}, "columns"), ...choice),
      make("button", {onclick: () => download(group)}, "download CSV"), make("button", {onclick: () => changed({sort: "", filter: "", family: "", columns: "", pin: [], open: []})}, "reset"), group.count);
  }

  async function begin(live) {
    const packed = live.querySelector("script[data-notes]"), bytes = Uint8Array.from(atob(packed.textContent.trim()), c => c.charCodeAt(0));
    const data = await new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).json();
    const pane = live.closest(".pane"), table = live.querySelector("table"), pair = make("section", {class: "pair", "aria-live": "polite"});
    const group = {...data, pane, table, pair, notes: packed.dataset.notes, head: table.tHead.rows[0], body: table.tBodies[0], axis: table.querySelector("th.axis")};
    group.tab = document.getElementById(pane.previousElementSibling.htmlFor);
    group.tab.addEventListener("change", () => changed({protocol: group.key === groups[0].key ? "" : group.key}));
    live.prepend(tools(group));
    live.append(pair);
    return group;
  }

  document.querySelectorAll(".charts figure").forEach(chart);
  Promise.all([...document.querySelectorAll(".live")].map(begin)).then(made => {
    groups.push(...made);
    if (groups.length) read();
    addEventListener("hashchange", read);
    document.documentElement.dataset.live = "yes";
  });
})();
