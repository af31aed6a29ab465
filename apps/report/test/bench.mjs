// Measures the page of a session of 20 segments: size, time until it is drawn, frames per second while it plays at
// 1280x720 in software rendering, and the CPU time of all of the browser's processes for both, which says what an idle
// machine would do when this one is busy. Nothing is asserted. Linux only.
//   node test/bench.mjs MAKE_RESULTS CHROMIUM FOLDER
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readdirSync, readFileSync, rmSync, statSync } from 'node:fs';
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
/** CPU time in ms of the browser and all of its descendants so far. */
function cpuMs() {
  const parents = new Map(), ticks = new Map();
  let browser = 0;
  for (const pid of readdirSync('/proc').filter((name) => /^\d+$/.test(name)).map(Number)) {
    try {
      const fields = readFileSync(`/proc/${pid}/stat`, 'utf8').replace(/^.*\) /s, '').split(' ');
      parents.set(pid, Number(fields[1]));
      ticks.set(pid, Number(fields[11]) + Number(fields[12]));
      const line = readFileSync(`/proc/${pid}/cmdline`, 'utf8');
      if (line.includes(`--user-data-dir=${profile}`) && !line.includes('--type=')) browser = pid;
    } catch { /* it has ended */ }
  }
  const isBrowsers = (pid) => pid === browser || (parents.has(pid) && isBrowsers(parents.get(pid)));
  return 10 * [...ticks].reduce((sum, [pid, count]) => sum + (isBrowsers(pid) ? count : 0), 0);
}
try {
  const opened = [], openedCpu = [];
  let played, playedCpu;
  for (let i = 0; i < 3; ++i) {
    const page = await context.newPage();
    const before = cpuMs();
    await page.goto(pathToFileURL(file).href + '#frame=0');
    await page.waitForSelector('html[data-ready]', { state: 'attached' });
    await page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done))));
    opened.push(await page.evaluate(() => Math.round(performance.now())));
    openedCpu.push(cpuMs() - before);
    if (i === 2) {
      await page.locator('#play').click();
      await page.waitForTimeout(1000);
      const start = cpuMs();
      played = await page.evaluate(async () => {
        const { viewer } = window.weft, from = viewer.drawn, started = performance.now();
        await new Promise((done) => setTimeout(done, 3000));
        const canvas = document.querySelector('.viewer canvas');
        return { drawn: viewer.drawn - from, seconds: (performance.now() - started) / 1000, canvas: [canvas.width, canvas.height] };
      });
      playedCpu = cpuMs() - start;
    }
    await page.close();
  }
  console.log(JSON.stringify({
    page_mb: statSync(file).size / 1e6, opened_ms: opened, opened_cpu_ms: openedCpu, frames_per_second: played.drawn / played.seconds, cpu_ms_per_frame: playedCpu / played.drawn, canvas: played.canvas,
    cpu: os.cpus()[0].model, cores: os.cpus().length, load: os.loadavg()[0],
  }, null, 1));
} finally {
  await context.close();
  rmSync(profile, { recursive: true, force: true });
}
