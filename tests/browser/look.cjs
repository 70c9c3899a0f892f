"use strict";
// What a browser makes of a page, as JSON: node look.cjs CHROMIUM PAGE PDF DOWNLOADS. NODE_PATH leads to the npm packages.
const {pathToFileURL} = require("node:url");
const fs = require("node:fs");
const puppeteer = require("puppeteer-core");
const axe = require("axe-core");

const [chromium, file, pdf, downloads] = process.argv.slice(2);
const address = pathToFileURL(file).href;

async function opened(browser, found, width, scheme, hash = "") {
  const page = await browser.newPage();
  page.on("console", message => found.console.push(message.text()));
  page.on("pageerror", error => found.console.push(String(error)));
  page.on("request", request => {
    if (request.url().split("#")[0] !== address && !/^(data|blob):/.test(request.url())) found.requests.push(request.url());
  });
  await page.emulateMediaFeatures([{name: "prefers-color-scheme", value: scheme}]);
  await page.setViewport({width, height: 900});
  await page.goto(address + hash);
  return page;
}

function front() {  // in the page, before anything is opened
  const bottom = e => e.getBoundingClientRect().bottom + scrollY;
  const pane = document.querySelector(".tabs > .pane");
  return {
    closed: document.querySelectorAll("details[open]").length === 0,
    systems: bottom(pane.querySelector(".systems tbody")),
    panes: [...document.querySelectorAll("main > .tabs > .pane")].map(e => e.offsetParent !== null),
    sideways: document.documentElement.scrollWidth - innerWidth,
  };
}

function open() {
  for (const e of document.querySelectorAll("details")) e.open = true;
}

function measured() {  // in the page
  const inView = e => { const r = e.getBoundingClientRect(); return r.width > 0 && r.left >= 0 && r.right <= innerWidth; };
  const table = document.querySelector("#published-numbers table");
  const column = [...table.querySelectorAll("thead th")].findIndex(th => th.textContent === "verdict");
  const cells = [...table.querySelectorAll("tbody tr:not(.group)")].map(row => row.children[column]);
  const size = text => {
    const svg = text.ownerSVGElement, box = svg.viewBox.baseVal, scale = box?.width ? svg.getBoundingClientRect().width / box.width : 1;
    return parseFloat(getComputedStyle(text).fontSize) * scale;
  };
  const small = [...document.querySelectorAll("table, figcaption, .notes")].map(e => parseFloat(getComputedStyle(e).fontSize));
  return {
    sideways: document.documentElement.scrollWidth - innerWidth,
    verdicts: cells.map(inView),
    titles: [...document.querySelectorAll("figure svg title")].map(title => title.textContent),
    sizes: [...new Set([...[...document.querySelectorAll("svg text")].filter(e => e.getBoundingClientRect().width).map(size), ...small].map(s => Math.round(s * 5) / 5))],
    first: document.querySelector(".answer .first").getBoundingClientRect().top + scrollY,
  };
}

async function keys(page) {
  await page.focus("#t-1");
  await page.keyboard.press("ArrowRight");
  const second = await page.evaluate(front);
  await page.keyboard.press("ArrowLeft");
  return {second};
}

function shown() {  // in the page: the first table, its headings, and the address
    const table = document.querySelector(".systems"), text = e => e.textContent.trim();
    return {
      address: decodeURIComponent(location.hash.replaceAll("+", " ")),
      names: [...table.querySelectorAll("tbody input")].map(e => e.dataset.pin),
      seeds: [...table.querySelectorAll(".seed th")].map(text),
      heads: [...table.tHead.querySelectorAll("button")].map(text),
      sorted: Object.fromEntries([...table.tHead.querySelectorAll("[aria-sort]")].map(e => [text(e), e.getAttribute("aria-sort")]).filter(e => e[1] !== "none")),
      rows: [...table.tBodies[0].rows].map(row => [...row.cells].filter(e => !e.querySelector(".bar")).map(text)),
      focus: document.activeElement.dataset.sort || "",
      pair: [...document.querySelectorAll(".pair")].map(text)[0],
      cells: [...document.querySelectorAll(".pair tbody")].slice(0, 2).map(body => [...body.rows].map(row => [...row.cells].map(text))),
      pinned: [...document.querySelector(".charts .pane").querySelectorAll(".mark.pinned text")].filter(e => getComputedStyle(e).display !== "none").map(text),
      about: document.querySelector(".about").textContent,
      sideways: document.documentElement.scrollWidth - innerWidth,
    };
}

async function live(browser, found, folder) {  // a visitor sorts, filters, compares, downloads and passes the address on
  const page = await opened(browser, found, 1200, "light"), states = {}, alive = () => page.waitForSelector("html[data-live]");
  const see = async name => { states[name] = await page.evaluate(shown); };
  const type = async text => { await page.$eval(".tools input", (e, value) => { e.value = value; e.dispatchEvent(new Event("input")); }, text); };
  await alive();
  await see("first");
  await page.click('[data-sort="flash"]');
  await see("clicked");
  await page.keyboard.press("Enter");
  await see("by keyboard");
  await type("jung");
  await see("filtered");
  await page.click(".seeds");
  await see("unfolded");
  await page.$eval('.tools input[value="test"]', e => e.click());
  await see("fewer columns");
  const client = await page.createCDPSession();
  await client.send("Browser.setDownloadBehavior", {behavior: "allow", downloadPath: folder});
  await page.$$eval(".tools button", buttons => buttons[0].click());
  for (let i = 0; i < 100 && !fs.readdirSync(folder).some(name => name.endsWith(".csv")); i++) await new Promise(done => setTimeout(done, 100));
  await type("");
  for (const box of [0, 0]) {
    const names = await page.$eval(".systems", e => [...e.querySelectorAll("tbody input:not(:checked)")].map(box => box.dataset.pin).sort());
    await page.click(`input[data-pin="${names[names.length - 2 + box]}"]`);
  }
  await see("compared");
  const address = await page.evaluate(() => location.hash);
  await page.evaluate(() => { location.hash += "&family=networks"; });
  await page.waitForFunction(() => !document.querySelector(".systems tbody input"));
  await see("no networks");
  await page.$eval(".mark", e => e.focus());
  const first = await page.$eval(".about", e => e.textContent);
  await page.keyboard.press("ArrowRight");
  await see("next mark");
  states["next mark"].before = first;
  await page.close();
  for (const width of [1200, 390]) {
    const other = await opened(browser, found, width, "light", address);
    await other.waitForSelector("html[data-live]");
    states[`opened ${width}`] = await other.evaluate(shown);
    await other.evaluate(axe.source);
    const result = await other.evaluate(() => axe.run(document, {resultTypes: ["violations"]}));
    found.violations[`compared ${width}`] = result.violations.map(v => [v.id, v.nodes.length, v.nodes[0].html.slice(0, 200)]);
    await other.close();
  }
  return states;
}

(async () => {
  const browser = await puppeteer.launch({executablePath: chromium, args: ["--no-sandbox", "--disable-gpu"]});
  const found = {console: [], requests: [], fronts: {}, views: {}, violations: {}};
  try {
    for (const scheme of ["light", "dark"]) for (const width of [1200, 390]) {
      const page = await opened(browser, found, width, scheme), name = `${scheme} ${width}`;
      found.fronts[name] = await page.evaluate(front);
      if (scheme === "light" && width === 1200) found.keys = await keys(page);
      await page.evaluate(open);
      found.views[name] = await page.evaluate(measured);
      await page.evaluate(axe.source);
      const result = await page.evaluate(() => axe.run(document, {resultTypes: ["violations"]}));
      found.violations[name] = result.violations.map(v => [v.id, v.nodes.length, v.nodes[0].html.slice(0, 200)]);
      await page.close();
    }
    found.live = await live(browser, found, downloads);
    const page = await opened(browser, found, 1200, "dark");
    await page.emulateMediaType("print");
    found.print = await page.evaluate(() => ({
      headings: [...document.querySelectorAll("h2, h3")].map(h => getComputedStyle(h).breakAfter),
      whole: [...document.querySelectorAll("figure, tr")].map(e => getComputedStyle(e).breakInside),
      ink: getComputedStyle(document.body).color,
    }));
    await page.pdf({path: pdf, preferCSSPageSize: true});
  } finally {
    await browser.close();
  }
  console.log(JSON.stringify(found));
})().catch(error => { console.error(error); process.exit(1); });
