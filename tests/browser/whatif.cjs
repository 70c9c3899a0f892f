"use strict";
// What the what-if panel of a page tells for some settings, as JSON: node whatif.cjs CHROMIUM PAGE SETTINGS.
// A setting has budgets and reactions by name.
const {pathToFileURL} = require("node:url");
const puppeteer = require("puppeteer-core");
const axe = require("axe-core");

const [chromium, file, settings] = process.argv.slice(2);

function told(setting) {  // in the page
  const form = document.querySelector(".what-if form");
  form.reset();
  for (const [name, value] of Object.entries({...setting.budgets, ...setting.reactions})) form.elements[name].value = value;
  form.dispatchEvent(new Event("input"));
  const status = form.querySelector("[role=status]"), last = status.querySelector("p:last-of-type code");
  return {
    lines: [...status.querySelectorAll("p")].map(p => p.textContent),
    scene: status.querySelector("pre")?.textContent ?? "",
    command: last ? last.textContent : "",
  };
}

(async () => {
  const browser = await puppeteer.launch({executablePath: chromium, args: ["--no-sandbox", "--disable-gpu"]});
  const found = {console: [], told: [], sideways: [], violations: []};
  try {
    for (const scheme of ["light", "dark"]) for (const width of [1200, 390]) {
      const page = await browser.newPage();
      page.on("console", message => found.console.push(message.text()));
      page.on("pageerror", error => found.console.push(String(error)));
      await page.emulateMediaFeatures([{name: "prefers-color-scheme", value: scheme}]);
      await page.setViewport({width, height: 900});
      await page.goto(pathToFileURL(file).href);
      await page.focus(".what-if summary");
      await page.keyboard.press("Enter");
      await page.waitForSelector(".what-if form");
      const every = JSON.parse(settings);
      if (!found.told.length) for (const setting of every) found.told.push(await page.evaluate(told, setting));
      await page.evaluate(told, every[every.length - 1]);
      found.sideways.push(await page.evaluate(() => document.documentElement.scrollWidth - innerWidth));
      await page.evaluate(axe.source);
      const result = await page.evaluate(() => axe.run(document, {resultTypes: ["violations"]}));
      found.violations.push(...result.violations.map(v => [v.id, v.nodes[0].html.slice(0, 200)]));
      await page.close();
    }
  } finally {
    await browser.close();
  }
  console.log(JSON.stringify(found));
})().catch(error => { console.error(error); process.exit(1); });
