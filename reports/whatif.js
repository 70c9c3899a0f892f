// The choice of `bench choose`, made again for budgets and reactions that the reader gives. A port of the rules of
// bench/outcomes/pick.py and reactions.py; tests/browser compares the two.
(() => {
  const TOLERANCE = 1e-9, NOTHING = "nothing";
  const LOWEST = {worst_person: () => 1, worst_tenth: people => Math.ceil(people / 10)};  // people whose mean error is a cost
  const even = x => {  // the nearest whole number; of two, the even one, as NumPy rounds
    const up = Math.round(x);
    return x - Math.floor(x) === 0.5 && up % 2 ? up - 1 : up;
  };
  const round = (x, digits) => even(x * 10 ** digits) / 10 ** digits;
  const mean = values => values.reduce((a, b) => a + b, 0) / values.length;  // NaN of none
  const known = values => values.filter(Number.isFinite);
  const percent = v => (Number.isInteger(v * 4) ? round(v, 1) : v).toFixed(1);
  const several = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;
  const amount = (cost, v) => `${v < 100 ? Number(v.toPrecision(3)) : even(v)} ${cost.unit}`;

  function pick(scores, fits, by) {  // numbers of the chosen and of the best candidate; undefined where none fits
    const means = scores.map(s => round(mean(known(s)), 9));
    const first = (can, low, lower) => means.map((_, i) => i).filter(can).sort((a, b) => low[a] - low[b] || lower[a] - lower[b])[0];
    const can = i => fits[i] && Number.isFinite(by[i]) && Number.isFinite(means[i]), worse = means.map(m => -m);
    const best = first(can, worse, by);
    const near = i => {
      const losses = scores[best].map((s, k) => s - scores[i][k]), loss = mean(losses), n = losses.length;
      const error = n > 1 ? Math.sqrt(losses.reduce((sum, l) => sum + (l - loss) ** 2, 0) / (n - 1) / n) : 0;
      return i === best || loss - error <= TOLERANCE * Math.max(1, Math.abs(loss), error);
    };
    return [first(i => can(i) && near(i), by, worse), best];
  }

  function scored(data, row, reactions) {  // scores of the subjects, with the most probable reaction to each capture
    const names = [...new Set([...reactions.filter(r => r !== NOTHING), NOTHING])], count = reactions.length;
    const reaction = reactions.map(r => names.indexOf(r));
    const seeds = row.values.map(([number, values]) => {
      const wrong = row.scores.map(() => 0), all = row.scores.map(() => 0);
      data.captures[number].forEach((code, c) => {
        const sums = names.map(() => 0), subject = Math.floor(code / count);
        for (let k = 0; k < count; k++) sums[reaction[k]] += values[c * count + k];
        const costs = sums.map((_, r) => round(sums.reduce((sum, s, other) => other === r ? sum : sum + s, 0), 12));
        all[subject]++;
        wrong[subject] += costs.indexOf(Math.min(...costs)) !== reaction[code % count];
      });
      return all.map((n, s) => 100 * (1 - wrong[s] / n));
    });
    return row.scores.map((_, s) => mean(known(seeds.map(seed => seed[s]))));
  }

  function decoded(text, captures, classes) {  // little endian, as all machines with a browser
    const bytes = Uint8Array.from(atob(text), c => c.charCodeAt(0));
    return bytes.length === 4 * captures * classes ? new Float32Array(bytes.buffer) : new Float64Array(bytes.buffer);
  }

  function decided(data, budgets, reactions) {  // candidates with their costs for these reactions, and the choice
    const decision = budgets.decision === undefined ? -1 : data.costs.findIndex(c => c.key === "decision");
    const soon = row => row.costs[decision] <= budgets.decision * (1 + TOLERANCE);
    const instants = row => data.rows.filter(r => r.replay === row.replay);  // the last that is soon enough, else the first
    const offered = data.rows.filter(row => row.replay === null || (decision >= 0 && row === (instants(row).filter(soon).pop() || instants(row)[0])));
    const rows = reactions ? offered.filter(row => row.values.length) : offered;
    const scores = rows.map(row => reactions ? scored(data, row, reactions) : row.scores);
    const costs = rows.map((row, i) => data.costs.map((c, k) => {
      if (!(c.key in LOWEST)) return row.costs[k];
      const lowest = known(scores[i]).sort((a, b) => a - b), n = LOWEST[c.key](scores[i].length);
      return lowest.length < n ? NaN : 100 - mean(lowest.slice(0, n));
    }));
    const fits = costs.map(of => data.costs.every((c, k) => !(c.key in budgets) || of[k] <= budgets[c.key] * (1 + TOLERANCE)));
    const [chosen, best] = pick(scores, fits, costs.map(of => of[0]));
    return {rows, scores, costs, fits, chosen, best, left: offered.filter(row => !rows.includes(row))};
  }

  function sentences(data, budgets, it) {  // as bench/outcomes/choice.py
    const {rows, scores, costs, fits, chosen, best} = it, flash = data.costs[0];
    const score = i => percent(round(mean(known(scores[i])), 9)) + " %";
    const unranked = rows.some((_, i) => fits[i] && !Number.isFinite(costs[i][0]));
    if (best === undefined) {
      const limits = data.costs.flatMap((c, k) => {
        if (!(c.key in budgets)) return [];
        const order = rows.map((_, i) => i).filter(i => Number.isFinite(costs[i][k])).sort((a, b) => costs[a][k] - costs[b][k]);
        const over = rows.length - order.filter(i => costs[i][k] <= budgets[c.key] * (1 + TOLERANCE)).length;
        const lowest = order.length ? ` The lowest ${c.noun} is ${amount(c, costs[order[0]][k])} (${rows[order[0]].name}).` : ` It is unknown: ${c.unknown}.`;
        return [`The budget of ${amount(c, budgets[c.key])} for ${c.noun} rules out ${over} of ${several(rows.length, "system")}.${lowest}`];
      });
      return [unranked ? `Nothing can be chosen: the ${flash.noun} of every system that fits is unknown (${flash.unknown}).` : "Nothing fits the budgets.", ...limits];
    }
    const that = "that fits" + (unranked ? ` and has a known ${flash.noun}` : "");
    const lines = [`Choose ${rows[chosen].name}: ${score(chosen)} with ${amount(flash, costs[chosen][0])} ${data.words}.`];
    const people = scores[best].length;
    if (chosen === best || people < 2) lines.push(`No system ${that} is more accurate${people > 1 ? ", and no cheaper one is within one standard error" : ""}.`);
    else lines.push(`It is the cheapest system within one standard error of the best one ${that} (${rows[best].name.replaceAll(" (", ", ").replace(/\)$/, "")}, ${score(best)}).`);
    return lines;
  }

  function scene(data, budgets, reactions) {  // the lines of a scene file
    const listed = names => `[${names.map(n => JSON.stringify(n)).join(", ")}]`, lines = ["[reactions]"];
    for (const name of new Set(reactions)) {
      const members = data.classes.filter((_, k) => reactions[k] === name);
      if (members.length > 1 || members[0] !== name) lines.push(`${name} = ${listed(members)}`);
    }
    const of = {budget: {}, faults: {}, people: {}}, key = {fault_loss: "loss", worst_fault: "worst"};
    for (const c of data.costs.filter(c => c.key in budgets)) {
      const most = budgets[c.key];
      if (c.key in key) of.faults[key[c.key]] = most;
      else if (c.key in LOWEST) of.people[c.key.replace("_person", "")] = Number((100 - most).toPrecision(12));
      else of.budget[c.key] = JSON.stringify(most + c.unit);
    }
    for (const [name, values] of Object.entries(of)) if (Object.keys(values).length)
      lines.push("", `[${name}]`, ...Object.entries(values).map(([k, v]) => `${k} = ${v}`));
    return lines.join("\n");
  }

  function panel(box) {
    const data = JSON.parse(box.querySelector("script").textContent), form = document.createElement("form");
    const add = (parent, name, text) => {
      const made = parent.appendChild(document.createElement(name));
      if (text !== undefined) made.textContent = text;
      return made;
    };
    for (const row of data.rows) {
      row.scores = row.scores.map(s => s ?? NaN);
      row.costs = row.costs.map(c => c ?? NaN);
      row.values = row.tables.map(([number, text]) => [number, decoded(text, data.captures[number].length, data.classes.length)]);
    }
    const field = (words, control, parent) => add(add(parent, "label", words + " "), control);
    const costs = add(form, "fieldset"), gestures = add(form, "fieldset"), told = add(form, "div");
    add(costs, "legend", "Budgets: the most of each cost; empty for none");
    add(gestures, "legend", "Reactions: gestures with the same number get the same reaction");
    const budgets = data.costs.map(c => {
      const input = field(`${c.noun}, ${c.unit}`, "input", costs);
      Object.assign(input, {type: "number", step: "any", name: c.key});
      if (c.budget !== null) input.setAttribute("value", c.budget);
      return input;
    });
    const selects = data.classes.map(name => {
      const select = field(name, "select", gestures);
      for (const option of ["own", ...Array.from({length: data.classes.length >> 1}, (_, i) => i + 1), NOTHING])
        select.append(new Option(option === NOTHING ? "no reaction" : option, option));
      select.name = name;
      return select;
    });
    if (!selects.length) gestures.remove();
    form.append(told);
    told.setAttribute("role", "status");

    function draw() {
      const most = {}, wrong = [], changed = selects.some(s => s.value !== "own");
      for (const input of budgets) if (input.value !== "" || input.validity.badInput) {
        const share = input.name in LOWEST, v = share ? Number(Number(input.value).toPrecision(6)) : Number(input.value);  // as a scene
        if (input.validity.badInput || !(v > 0) || (share && (v < 0.1 || v > 100))) wrong.push(input.name);
        most[input.name] = v;
      }
      told.replaceChildren();
      if (wrong.length) {
        for (const c of data.costs.filter(c => wrong.includes(c.key)))
          add(told, "p", `The budget for ${c.noun} is no number ${c.unit === "%" ? "from 0.1 to 100" : "above 0"}.`);
        return;
      }
      const reactions = changed ? selects.map((s, k) => s.value === "own" ? data.classes[k] : s.value === NOTHING ? NOTHING : `reaction_${s.value}`) : null;
      const blocked = changed && Object.keys(most).some(name => name.includes("fault"));
      if (blocked) add(told, "p", "This page has losses under faults for single gestures alone. Empty these budgets, or use the scene below.");
      else {
        const it = decided(data, most, reactions);
        sentences(data, most, it).forEach((line, i) => add(told, "p", line).className = i ? "" : "first");
        if (it.left.length) {
          const more = it.left.length > 3 ? ` and ${it.left.length - 3} more` : "";
          add(told, "p", `Left out: ${it.left.slice(0, 3).map(row => row.name).join("; ")}${more}. ` +
            "This page lacks their probabilities for whole captures; bench choose with this scene may choose one of them.");
        }
      }
      if (data.note) add(told, "p", data.note);
      let command = data.command;
      if (changed) {
        add(told, "p", "The scene, to save as scene.toml:");
        const text = add(told, "pre");
        text.tabIndex = 0;
        add(text, "code", scene(data, most, reactions));
        command += " scene=scene.toml";
      } else for (const c of data.costs.filter(c => c.key in most)) command += ` max_${c.key}=${most[c.key]}${["points", "%"].includes(c.unit) ? "" : c.unit}`;
      if (data.command) add(add(told, "p", "Command: "), "code", command);
    }
    form.addEventListener("input", draw);
    form.addEventListener("submit", event => event.preventDefault());
    box.append(form);
    draw();
  }

  for (const box of document.querySelectorAll(".what-if")) box.addEventListener("toggle", () => panel(box), {once: true});
})();
