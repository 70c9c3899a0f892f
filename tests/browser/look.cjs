"use strict";
// What a browser makes of a page, as JSON: node look.cjs CHROMIUM PAGE PDF. NODE_PATH leads to the npm packages.
const {pathToFileURL} = require("node:url");
const puppeteer = require("puppeteer-core");
const axe = require("axe-core");

const [chromium, file, pdf] = process.argv.slice(2);
const address = pathToFileURL(file).href;

async function opened(browser, found, width, scheme) {
  const page = await browser.newPage();
  page.on("console", message => found.console.push(message.text()));
  page.on("pageerror", error => found.console.push(String(error)));
  page.on("request", request => {
    if (request.url() !== address && !request.url().startsWith("data:")) found.requests.push(request.url());
  });
  await page.emulateMediaFeatures([{name: "prefers-color-scheme", value: scheme}]);
  await page.setViewport({width, height: 900});
  await page.goto(address);
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
    const svg = text.ownerSVGElement, scale = svg.getBoundingClientRect().width / svg.viewBox.baseVal.width;
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
