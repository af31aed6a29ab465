// Measures the page of a session of 20 segments: size, time until it is drawn, frames per second while it plays at
// 1280x720. Nothing is asserted, since the machine may be busy.
//   node test/bench.mjs MAKE_RESULTS CHROMIUM FOLDER
import { execFileSync } from 'node:child_process';
import { mkdtempSync, rmSync, statSync } from 'node:fs';
import os from 'node:os';
import path from 'node:path';
import { pathToFileURL } from 'node:url';
import { chromium } from 'playwright-core';

const [makeResults, executablePath, folder] = process.argv.slice(2);
execFileSync(makeResults, ['session', folder, '20'], { stdio: 'inherit' });
const file = path.join(folder, 'report.html');
const profile = mkdtempSync(path.join(os.tmpdir(), 'weft-report-'));
const context = await chromium.launchPersistentContext(profile, {
  executablePath, headless: true, viewport: { width: 1280, height: 720 }, timeout: 60000,
  args: ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});
try {
  const opened = [];
  let played;
  for (let i = 0; i < 3; ++i) {
    const page = await context.newPage();
    await page.goto(pathToFileURL(file).href + '#frame=0');
    await page.waitForSelector('html[data-ready]', { state: 'attached' });
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    opened.push(await page.evaluate(() => Math.round(performance.now())));
    if (i === 2) {
      await page.locator('#play').click();
      await page.waitForTimeout(1000);
      played = await page.evaluate(async () => {
        const { viewer } = window.weft, from = viewer.drawn, started = performance.now();
        await new Promise((done) => setTimeout(done, 3000));
        const canvas = document.querySelector('.viewer canvas');
        return { drawn: viewer.drawn - from, seconds: (performance.now() - started) / 1000, canvas: [canvas.width, canvas.height] };
      });
    }
    await page.close();
  }
  console.log(JSON.stringify({
    page_mb: statSync(file).size / 1e6, opened_ms: opened, frames_per_second: played.drawn / played.seconds, canvas: played.canvas,
    cpu: os.cpus()[0].model, cores: os.cpus().length, load: os.loadavg()[0],
  }, null, 1));
} finally {
  await context.close();
  rmSync(profile, { recursive: true, force: true });
}
