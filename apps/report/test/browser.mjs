// Report pages and exports in a real browser: made-up results, and a real session.
//   node test/browser.mjs MAKE_RESULTS WEFT CHROMIUM SOURCES FOLDER
// Fails on the first thing that is not as it must be. test/bench.mjs measures.
import assert from 'node:assert/strict';
import { execFileSync } from 'node:child_process';
import { mkdtempSync, readFileSync, rmSync, statSync, writeFileSync } from 'node:fs';
import { tmpdir } from 'node:os';
import path from 'node:path';
import { pathToFileURL } from 'node:url';
import { inflateSync } from 'node:zlib';
import { build } from 'esbuild';
import { chromium } from 'playwright-core';

const [makeResults, weft, executablePath, sources, folder] = process.argv.slice(2);
const run = (program, ...args) => execFileSync(program, args, { encoding: 'utf8', stdio: ['ignore', 'pipe', 'inherit'] });
const json = (...parts) => JSON.parse(readFileSync(path.join(folder, ...parts), 'utf8'));
const say = (text) => console.log(text);

rmSync(folder, { recursive: true, force: true });
for (const kind of ['session', 'evaluation', 'physics', 'ablation']) run(makeResults, kind, path.join(folder, kind));

const profile = mkdtempSync(path.join(tmpdir(), 'weft-report-'));
const context = await chromium.launchPersistentContext(profile, {
  executablePath, headless: true, viewport: { width: 1280, height: 720 }, timeout: 60000,
  args: ['--no-sandbox', '--disable-gpu', '--disable-quic', '--no-first-run', '--disable-background-networking', '--disable-component-update', '--disable-sync'],
});
context.setDefaultTimeout(30000);

/** Opens a page that must say nothing on the console and fetch nothing. */
async function open(file, hash = '') {
  const page = await context.newPage();
  page.problems = [];
  // Taking a picture of a page makes the graphics driver warn that it was slow; that is no fault of the page.
  page.on('console', (message) => ['error', 'warning'].includes(message.type()) && !message.text().includes('GL Driver Message') && page.problems.push(message.text()));
  page.on('pageerror', (error) => page.problems.push(error.stack));
  page.on('request', (request) => /^(https?|ws)/.test(request.url()) && page.problems.push(`fetched ${request.url()}`));
  await page.goto(pathToFileURL(file).href + hash);
  await page.waitForSelector('html[data-ready]', { state: 'attached' });
  return page;
}
const text = (page, selector) => page.locator(selector).first().innerText();
const shown = (page, key) => text(page, `[data-key="${key}"]`);

/** Pixels of a PNG picture (8 bits per channel, RGB or RGBA, not interlaced). */
function pixelsOf(png) {
  let at = 8, width = 0, height = 0, channels = 0;
  const parts = [];
  while (at < png.length) {
    const length = png.readUInt32BE(at), type = png.toString('latin1', at + 4, at + 8), data = png.subarray(at + 8, at + 8 + length);
    if (type === 'IHDR') {
      width = data.readUInt32BE(0);
      height = data.readUInt32BE(4);
      channels = { 2: 3, 6: 4 }[data[9]];
      assert.ok(data[8] === 8 && channels && data[12] === 0);
    }
    if (type === 'IDAT') parts.push(data);
    at += length + 12;
  }
  const raw = inflateSync(Buffer.concat(parts)), stride = width * channels;
  const out = Buffer.alloc(stride * height);
  for (let y = 0; y < height; ++y) {
    const filter = raw[y * (stride + 1)];
    for (let i = 0; i < stride; ++i) {
      const value = raw[y * (stride + 1) + 1 + i];
      const a = i >= channels ? out[y * stride + i - channels] : 0, b = y > 0 ? out[(y - 1) * stride + i] : 0;
      const c = i >= channels && y > 0 ? out[(y - 1) * stride + i - channels] : 0;
      const p = a + b - c;
      const paeth = Math.abs(p - a) <= Math.abs(p - b) && Math.abs(p - a) <= Math.abs(p - c) ? a : Math.abs(p - b) <= Math.abs(p - c) ? b : c;
      out[y * stride + i] = value + [0, a, b, (a + b) >> 1, paeth][filter];
    }
  }
  return { width, height, channels, data: out };
}
/** How many pixels look like the cloth's front (blue), its back (orange), the goal (green), or strongly coloured at all. */
function count(png) {
  const { data, channels } = pixelsOf(png);
  const result = { blue: 0, orange: 0, green: 0, coloured: 0 };
  for (let i = 0; i < data.length; i += channels) {
    const r = data[i], g = data[i + 1], b = data[i + 2];
    if (Math.max(r, g, b) - Math.min(r, g, b) > 50) ++result.coloured;
    if (b > r + 50 && b > g + 20) ++result.blue;
    if (r > b + 60 && r > g + 20) ++result.orange;
    if (g > r + 30 && g > b + 5) ++result.green;
  }
  return result;
}
const look = async (page, within = '') => count(await page.locator(`${within} .viewer canvas`).first().screenshot());
const nextFrames = (page) => page.evaluate(() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => requestAnimationFrame(done)))));

async function sessionPage() {
  const file = path.join(folder, 'session', 'report.html'), summary = { ...json('session', 'summary.json'), ...json('session', 'times.json')['summary.json'] };
  const size = statSync(file).size;
  assert.ok(size < 5e6, `the page has ${size} bytes`);
  const page = await open(file);
  await nextFrames(page);
  say(`session page: ${(size / 1e6).toFixed(2)} MB`);

  // Numbers are those of summary.json.
  assert.equal(await shown(page, 'error_mm'), summary.error_mm.toFixed(1));
  assert.equal(await shown(page, 'default_error_mm'), summary.default_error_mm.toFixed(1));
  for (const key of ['max_error_mm', 'grasped_error_mm', 'named_error_mm']) assert.equal(await shown(page, key), summary[key].toFixed(1));
  assert.ok(summary.silhouette_iou > 0 && summary.silhouette_iou <= 1);
  assert.equal(await shown(page, 'silhouette_iou'), summary.silhouette_iou.toFixed(3));
  const reached = [10, 20, 30].find((limit) => summary[`success_${limit}mm`]);
  assert.equal(await shown(page, 'success'), reached ? `within ${reached}` : 'not within 30');
  assert.match(await text(page, 'header'), /world: constants of the fabric ± 20 %, simulator cloth/);
  assert.equal(await shown(page, 'segments'), String(summary.segments));
  await page.locator('#numbers summary').click();
  const rows = await page.locator('#numbers tbody tr').evaluateAll((all) => all.map((row) => [...row.cells].map((cell) => cell.textContent)));
  assert.equal(rows.length, summary.segments);
  rows.forEach((row, i) => {
    assert.equal(row[2], summary.predicted_error_mm[i].toFixed(2));
    assert.equal(row[4], summary.plan_seconds[i].toFixed(2));
    assert.equal(row[5], String(summary.plan_iterations[i]));
    assert.equal(row[6], `${summary.knowledge[i].centre[0].toFixed(2)} ± ${(summary.knowledge[i].width[0] / 2).toFixed(2)}`);
  });
  assert.equal(rows.at(-1)[1], summary.error_mm.toFixed(2));
  assert.equal(await page.locator('#material svg').count(), 4);
  assert.match(await text(page, '#material'), /estimated after each segment/);
  assert.match(await text(page, '#material'), new RegExp(`Bend\\s+true ${summary.true_material[1].toFixed(2)}`));

  // It shows the settled cloth, with the goal over it.
  assert.match(await text(page, '#where'), /settled/);
  const final = await look(page);
  assert.ok(final.coloured > 10000, `drawn pixels: ${JSON.stringify(final)}`);
  await page.locator('#show-goal').uncheck();
  await nextFrames(page);
  const alone = await look(page);
  assert.ok(alone.orange > 2000 && alone.green < final.green, `back of the cloth after the fold: ${JSON.stringify(alone)}`);

  // Scrubbing, by key and by button.
  await page.locator('#scrub').focus();
  await page.keyboard.press('Home');
  await nextFrames(page);
  assert.match(await text(page, '#where'), /^frame 0 /);
  const start = await look(page);
  assert.ok(start.blue > 10000 && start.orange < 200, `flat cloth seen from above: ${JSON.stringify(start)}`);
  await page.keyboard.press('ArrowRight');
  assert.match(await text(page, '#where'), /^frame 1 .* segment 1 of 20/);
  await page.locator('#next').click();
  assert.match(await text(page, '#where'), /^frame 12 /);
  await page.keyboard.press(']');
  assert.match(await text(page, '#where'), /^frame 24 .* segment 2 of 20/);
  await page.locator('#previous').click();
  assert.match(await text(page, '#where'), /^frame 12 /);
  assert.ok(Math.abs(parseFloat(await shown(page, 'segment-error')) - Number(rows[0][1])) <= 0.051);

  // Rounds: the prediction of a chosen round, and its planning losses.
  await page.locator('#round').selectOption('4');
  assert.equal(await page.locator('#follow').isChecked(), false);
  assert.match(await text(page, '#loss-note'), /^Round 5: 30 iterations of 16 instances .* mm²\. It ran out of budget \(max_iterations\); all instances: converged 3, budget spent 13\.$/);
  await page.locator('#scrub').evaluate((range) => {
    range.value = '96';
    range.dispatchEvent(new Event('input'));
  });
  const ahead = await shown(page, 'prediction-error');
  assert.match(ahead, /^\d+\.\d mm$/);
  await page.locator('#show-prediction').check();
  await page.locator('#show-planned').check();
  for (const colouring of ['goal', 'prediction', 'sigma']) {
    await page.locator('#colouring').selectOption(colouring);
    await nextFrames(page);
    assert.ok(await page.locator('.legend').isVisible());
    assert.ok((await look(page)).coloured > 5000, colouring);
  }
  await page.locator('#colouring').selectOption('fabric');
  await page.locator('#show-edges').check();

  // The view turns, by key.
  const before = await page.locator('.viewer canvas').screenshot();
  await page.locator('.viewer canvas').focus();
  for (let i = 0; i < 5; ++i) await page.keyboard.press('ArrowLeft');
  await page.keyboard.press('+');
  await nextFrames(page);
  assert.notDeepEqual(await page.locator('.viewer canvas').screenshot(), before);
  await page.keyboard.press('r');

  // Playing, slowly: the machine may be busy.
  await page.getByLabel('Speed').selectOption('0.1');
  await page.locator('#follow').check();
  await page.locator('#scrub').evaluate((range) => {
    range.value = '0';
    range.dispatchEvent(new Event('input'));
  });
  await page.locator('#play').click();
  assert.equal(await text(page, '#play'), 'Pause');
  await page.waitForFunction(() => Number(document.querySelector('#scrub').value) > 10);
  await page.keyboard.press(' ');
  assert.equal(await text(page, '#play'), 'Play');
  const held = await page.locator('#scrub').inputValue();
  assert.equal(await page.locator('#round').inputValue(), String(Math.max(0, Math.ceil(Number(held) / 12) - 1)));
  await nextFrames(page);
  assert.equal(await page.locator('#scrub').inputValue(), held);
  await page.locator('#scrub').evaluate((range) => {
    range.value = '270';
    range.dispatchEvent(new Event('input'));
  });
  assert.match(await text(page, '#where'), /^released, settling · 4\.50 s, 0\.50 s after release/);

  // Dark, and as narrow as a phone.
  await page.locator('#theme').selectOption('dark');
  const dark = await page.evaluate(() => getComputedStyle(document.documentElement).backgroundColor);
  assert.equal(dark, 'rgb(20, 23, 27)');
  await page.setViewportSize({ width: 390, height: 844 });
  await nextFrames(page);
  assert.ok((await page.evaluate(() => document.documentElement.scrollWidth)) <= 390, 'the page is wider than a phone');
  assert.ok((await look(page)).coloured > 3000);
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** A session of the program itself, on a coarse towel and without a search, to keep it short. */
async function realSession() {
  const out = path.join(folder, 'real');
  const config = path.join(folder, 'fold.yaml');
  writeFileSync(config, `garment: ${sources}/configs/garments/towel_coarse.yaml
material: ${sources}/configs/fabrics/basic.yaml
manipulation: {grasp: [left_bottom, left_top], displacement_m: [0.38, 0]}
simulator: {plugin: cloth}
trajectory: {plugin: arc}
predictor: {plugin: rollout}
planning: {instances: 1, iterations: 1, replan_iterations: 0, horizon: 14}
goal: {controls: [1.5, 0, 0.05, 0.0002, 0]}
settle: {max_frames: 50}
`);
  const said = run(weft, 'run', config, '--out', out);
  assert.match(said, /report\.html/);
  const page = await open(path.join(out, 'report.html'));
  await nextFrames(page);
  const summary = json('real', 'summary.json');
  assert.equal(await shown(page, 'error_mm'), summary.error_mm.toFixed(1));
  assert.equal(await shown(page, 'segments'), String(summary.segments));
  assert.equal(await page.locator('#scrub').getAttribute('max'), String(12 * summary.segments + summary.settle_frames));
  assert.match(await text(page, '#where'), /^end, still moving · /);
  await page.locator('#numbers summary').click();
  const errors = await page.locator('#numbers tbody tr td:nth-child(2)').allInnerTexts();
  assert.ok(Math.abs(Number(errors.at(-1)) - summary.error_mm) <= 0.0051);
  const end = await look(page);
  assert.ok(end.coloured > 10000, JSON.stringify(end));
  for (const name of ['dtheta', 'dr', 'dphi', 'dax', 'day']) assert.ok((await text(page, '#controls')).includes(name));
  assert.deepEqual(page.problems, []);
  await page.close();
}

async function evaluationPage() {
  const page = await open(path.join(folder, 'evaluation', 'report.html'));
  const planning = json('evaluation', 'planning.json'), estimation = json('evaluation', 'estimation.json');
  assert.equal(await shown(page, 'median_mm'), planning.by_width[0].median_mm.toFixed(1));
  assert.match(await text(page, '#planning .tiles'), /1 failed/);
  await page.locator('#planning-numbers summary').click();
  const rows = await page.locator('#planning-numbers tbody tr').evaluateAll((all) => all.map((row) => [...row.cells].map((cell) => cell.textContent)));
  planning.by_width.forEach((box, i) => assert.deepEqual(rows[i], [String(box.width), String(box.n), box.median_mm.toFixed(2), box.mean_mm.toFixed(2),
    box.sd_mm.toFixed(2), `${box.q1_mm.toFixed(2)} – ${box.q3_mm.toFixed(2)}`, String(box.outliers),
    box.silhouette_iou.toFixed(3), `${(100 * box.success_10mm).toFixed(0)} %, 100 %, –`]));

  // Cases in 3D: by list, and by a click on a point of the figure.
  await nextFrames(page);
  assert.ok((await look(page)).coloured > 5000);
  assert.match(await text(page, '#planning-note'), new RegExp(`^Case 1, goal 1: ${planning.cases[0].error_mm.toFixed(1)} mm`));
  await page.locator('#planning-case-next').click();
  assert.match(await text(page, '#planning-note'), /^Case 2, goal 2/);
  await page.locator('#planning-figure [aria-label="case 20"] circle, #planning-figure circle[aria-label="case 20"]').first().dispatchEvent('click', { bubbles: true });
  assert.match(await text(page, '#planning-note'), new RegExp(`^Case 21, goal 5: ${planning.cases[20].error_mm.toFixed(1)} mm`));

  // Table 1 and Fig. 4.
  for (const name of ['bend', 'friction', 'stretch', 'thickness']) {
    const { abs_error: error, width } = estimation.properties[name];
    assert.equal(await shown(page, `${name} |c − q|`), `${error.mean.toFixed(3)} (${error.sd.toFixed(3)}), median ${error.median.toFixed(3)}`);
    assert.equal(await shown(page, `${name} w`), `${width.mean.toFixed(2)} (${width.sd.toFixed(2)}), median ${width.median.toFixed(2)}`);
    assert.equal(await shown(page, `${name} Within a = 0.5, 0.8, 1`), ['0.5', '0.8', '1'].map((a) => estimation.properties[name].coverage[a].toFixed(2)).join(', '));
  }
  assert.match(await text(page, '#table-1'), /0\.061 \(0\.053\), median 0\.044/);
  assert.match(await text(page, '#estimation-table'), /n = 50 \(1 failed\), the paper n = 50/);
  assert.equal(await page.locator('#estimation-columns tbody tr').count(), 4);
  await page.locator('#estimation-case').selectOption('7');
  assert.match(await text(page, '#fig-4'), new RegExp(`true ${estimation.cases[7].true_material[0].toFixed(2)}`));
  assert.equal(await page.locator('#fig-4 svg').count(), 4);

  // A replayed manipulation in 3D: by a click on its point, over segments by key, and by a click in a figure.
  await page.locator('#estimation-overview [aria-label="case 11"]').first().dispatchEvent('click', { bubbles: true });
  assert.equal(await page.locator('#estimation-case').inputValue(), '11');
  assert.equal(await text(page, '#estimation-where'), 'after segment 12 of 12');
  await nextFrames(page);
  const folded = await look(page, '#estimation');
  assert.ok(folded.orange > 2000, `back of the cloth after the fold: ${JSON.stringify(folded)}`);
  await page.locator('#estimation-segment').focus();
  await page.keyboard.press('Home');
  assert.equal(await text(page, '#estimation-where'), 'at the start');
  await nextFrames(page);
  const flat = await look(page, '#estimation');
  assert.ok(flat.blue > 5000 && flat.orange < 200, `flat cloth: ${JSON.stringify(flat)}`);
  await page.locator('#fig-4 svg').first().click();
  assert.match(await text(page, '#estimation-where'), /^after segment [567] of 12$/);

  // Predicted shapes in 3D: of the first 30 of 40.
  assert.equal(await page.locator('#prediction-case option').count(), 30);
  await page.locator('#prediction-cases [aria-label="case 17"]').first().dispatchEvent('click', { bubbles: true });
  const predicted = json('evaluation', 'prediction.json').cases[17];
  assert.match(await text(page, '#prediction-note'), new RegExp(`^Example ${predicted.example}, ${predicted.segments} segments ahead: predicted ${predicted.error_mm.toFixed(1)} mm off`));
  await nextFrames(page);
  assert.ok((await look(page, '#prediction')).coloured > 3000);
  await page.setViewportSize({ width: 390, height: 844 });
  await nextFrames(page);
  assert.ok((await page.evaluate(() => document.documentElement.scrollWidth)) <= 390, 'the page is wider than a phone');
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** The page of the command itself: a predictor that simulates, on a few examples of a coarse towel. */
async function realPrediction() {
  const config = `${sources}/configs/experiments/towel_small.yaml`, data = path.join(folder, 'data'), out = path.join(folder, 'prediction');
  run(weft, 'generate', config, '--examples', '16', '--quiet', '--out', data);
  run(weft, 'evaluate', 'prediction', config, '--set', 'predictor={plugin: rollout}', '--set', 'data.test_fraction=0.2', '--data', data, '--quiet', '--out', out);
  const prediction = json('prediction', 'prediction.json');
  const page = await open(path.join(out, 'report.html'));
  await nextFrames(page);
  const row = await page.locator('#prediction-table tbody tr').first().evaluate((tr) => [...tr.cells].map((cell) => cell.textContent));
  assert.deepEqual(row.slice(0, 4), ['from the start', String(prediction.settled.from_start.n), prediction.settled.from_start.mean_mm.toFixed(2), prediction.settled.from_start.median_mm.toFixed(2)]);
  await page.locator('#prediction-numbers summary').click();
  const steps = await page.locator('#prediction-numbers tbody tr').evaluateAll((all) => all.slice(0, 3).map((tr) => [...tr.cells].slice(1, 4).map((cell) => cell.textContent)));
  assert.deepEqual(steps, prediction.by_step.slice(0, 3).map((one) => [String(one.steps), String(one.n), one.mean_mm.toFixed(2)]));
  const baselines = await page.locator('#prediction-table tbody tr').count();
  assert.equal(baselines, 3 + Object.keys(prediction.baselines).length);
  const dots = await page.locator('#prediction-steps svg [aria-label="dot"] circle').count();
  assert.equal(dots, prediction.by_step.length + prediction.by_step_from_random.length + prediction.by_step_no_knowledge.length);
  assert.equal(prediction.cases.length, prediction.settled.from_start.n);
  assert.match(await text(page, '#prediction-note'), new RegExp(`: predicted ${prediction.cases[0].error_mm.toFixed(1)} mm off`));
  assert.ok((await look(page)).coloured > 3000);
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** Comparisons with their bounds: made up for what goes wrong, and of the command itself. */
async function physicsPages() {
  const data = json('physics', 'physics.json');
  let page = await open(path.join(folder, 'physics', 'report.html'));
  assert.equal(await shown(page, 'outside'), String(data.failed));
  assert.match(await text(page, '.warning'), new RegExp(`^Warning: ${data.failed} of ${data.comparisons} `));
  const tests = () => page.locator('#physics-worst tbody td:first-child').allInnerTexts();
  assert.deepEqual(await tests(), ['incline', 'catenary', 'folds', 'elastica', 'rest']);  // by error / bound
  await page.locator('#physics-worst [data-sort="n"]').press('Enter');
  assert.deepEqual(await tests(), ['catenary', 'rest', 'incline', 'folds', 'elastica']);
  const elastica = data.rows.filter((row) => row.test === 'elastica'), worst = Math.max(...elastica.map((row) => row.error / row.bound));
  assert.equal(await shown(page, 'elastica share'), `${(100 * worst).toFixed(1)} %`);
  await page.locator('#physics-worst').getByRole('button', { name: 'elastica' }).click();
  assert.equal(await page.locator('#physics-rows tbody tr').count(), elastica.length);
  await page.locator('#physics-test').selectOption('');
  await page.locator('#physics-outside').check();
  assert.equal(await text(page, '#physics-count'), `${data.failed} of ${data.comparisons}`);
  assert.match(await text(page, '#physics-rows'), /the simulation diverged at frame 12/);
  assert.match(await text(page, '#physics-folds'), /outside: seed 17/);
  assert.equal(await page.locator('#physics-folds [aria-label="dot"] circle').count(), 19);
  assert.deepEqual(page.problems, []);
  await page.close();

  run(weft, 'evaluate', 'physics', `${sources}/configs/experiments/physics.yaml`, '--set', 'physics.tests=[free fall, rest]', '--quiet', '--out', path.join(folder, 'real-physics'));
  const { rows } = json('real-physics', 'physics.json');
  page = await open(path.join(folder, 'real-physics', 'report.html'));
  assert.deepEqual((await page.locator('#physics-rows tbody td:nth-child(4)').allInnerTexts()).sort(), rows.map((row) => row.case).sort());
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** Pages of the commands themselves, with an untrained network on a coarse towel. */
async function realEvaluations() {
  const quick = [`${sources}/configs/experiments/towel_small.yaml`, '--set', 'predictor.params.untrained=true', '--set', 'planning={instances: 2, iterations: 1, replan_iterations: 0}',
    '--set', 'estimation={instances: 2, iterations: 2, later_iterations: 1}', '--set', 'goal.random.min_distance_mm=5', '--set', 'max_segments=12', '--cases', '2', '--quiet'];
  run(weft, 'evaluate', 'planning', ...quick, '--widths', '0.1', '1', '--out', path.join(folder, 'real-planning'));
  const planning = json('real-planning', 'planning.json');
  let page = await open(path.join(folder, 'real-planning', 'report.html'));
  await nextFrames(page);
  assert.equal(await shown(page, 'median_mm'), planning.by_width[0].median_mm.toFixed(1));
  assert.match(await text(page, '#planning-note'), new RegExp(`^Case 1, goal 1: ${planning.cases[0].error_mm.toFixed(1)} mm`));
  assert.ok((await look(page)).coloured > 3000);
  await page.locator('#planning-case-next').click();
  assert.match(await text(page, '#planning-note'), new RegExp(`^Case 2, goal 2: ${planning.cases[1].error_mm.toFixed(1)} mm`));
  assert.deepEqual(page.problems, []);
  await page.close();

  run(weft, 'evaluate', 'estimation', ...quick, '--out', path.join(folder, 'real-estimation'));
  const { properties, cases } = json('real-estimation', 'estimation.json');
  page = await open(path.join(folder, 'real-estimation', 'report.html'));
  await nextFrames(page);
  for (const name of ['bend', 'friction', 'stretch', 'thickness']) {
    const { mean, sd, median } = properties[name].abs_error;
    assert.equal(await shown(page, `${name} |c − q|`), `${mean.toFixed(3)} (${sd.toFixed(3)}), median ${median.toFixed(3)}`);
  }
  await page.locator('#estimation-case-next').click();
  const last = cases[1].knowledge.at(-1);
  assert.match(await text(page, '#fig-4'), new RegExp(`${last.centre[0].toFixed(2)} ± ${(last.width[0] / 2).toFixed(2)}, true ${cases[1].true_material[0].toFixed(2)}`));
  const segments = cases[1].knowledge.length - 1;
  assert.equal(await text(page, '#estimation-where'), `after segment ${segments} of ${segments}`);
  await nextFrames(page);
  assert.ok((await look(page, '#estimation')).coloured > 3000);
  assert.deepEqual(page.problems, []);
  await page.close();
}

async function ablationPage() {
  const page = await open(path.join(folder, 'ablation', 'report.html'));
  const ablation = json('ablation', 'ablation.json');
  const names = () => page.locator('#arms tbody tr td:first-child').allInnerTexts();
  const ran = ablation.arms.filter((arm) => arm.done > 0), none = ablation.arms.filter((arm) => arm.done === 0).map((arm) => arm.name);
  assert.equal(none.length, 1);
  const by = (metric) => [...ran].sort((a, b) => a.metrics[metric].mean - b.metrics[metric].mean).map((arm) => arm.name);
  const plain = async () => (await names()).map((name) => name.replace(' (baseline)', ''));
  assert.deepEqual(await plain(), [...by('error_mm'), ...none]);
  await page.locator('[data-sort="plan_seconds"]').click();
  assert.deepEqual(await plain(), [...by('plan_seconds'), ...none]);
  await page.locator('[data-sort="plan_seconds"]').click();
  assert.deepEqual(await plain(), [...by('plan_seconds').reverse(), ...none]);
  assert.match(await text(page, '.warning'), /^Warning: 22 of 240 cells failed/);
  await page.locator('#failures summary').click();
  assert.equal((await text(page, '#failures pre')).split('\n').length, 22);
  const { mean, mean_95: interval } = ablation.arms[0].metrics.error_mm;
  assert.equal(await shown(page, `${ablation.arms[0].name} error_mm`), `${mean.toFixed(2)} [${interval[0].toFixed(2)}, ${interval[1].toFixed(2)}]`);
  assert.equal(await page.locator('[data-sort="simulate_seconds"]').count(), 0);
  assert.match(await text(page, '#arms thead'), /Success within 10 mm/);
  await page.locator('#all-metrics').check();
  await page.locator('[data-sort="simulate_seconds"]').click();
  await page.locator('#metric').selectOption('plan_seconds');
  await page.locator('#factor').selectOption('planning.instances');
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** The page of the command itself, over the session of realSession(). */
async function realAblation() {
  const config = path.join(folder, 'ablation.yaml'), out = path.join(folder, 'real-ablation');
  writeFileSync(config, 'description: does a step of the search help?\ntask: fold.yaml\nfactors: {search: {none: {planning: {iterations: 0}}, one: {planning: {iterations: 1}}, broken: {goal: {controls: null, random: {min_distance_mm: 1000, attempts: 1}}}}}\nbaseline: none\nseeds: {first: 1, count: 2}\n');
  assert.throws(() => run(weft, 'ablate', config, '--quiet', '--out', out), { status: 1 });  // two cells fail
  const ablation = json('real-ablation', 'ablation.json');
  const page = await open(path.join(out, 'report.html'));
  assert.equal(await page.locator('#arms tbody tr').count(), 3);
  assert.match(await text(page, '.warning'), /^Warning: 2 of 6 cells failed/);
  assert.match(await page.locator('#failures pre').textContent(), /^broken, seed 1: .*none of 1 random trajectories/);
  for (const arm of ablation.arms.filter((one) => one.done > 0)) {
    const shownText = await shown(page, `${arm.name} error_mm`);
    assert.ok(shownText.startsWith(arm.metrics.error_mm.mean.toFixed(2)), `${arm.name}: ${shownText}`);
  }
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** Two simulators side by side: cases in the place of seeds, errors that are small numbers. */
async function realSimulators() {
  const config = path.join(folder, 'simulators.yaml'), out = path.join(folder, 'real-simulators');
  writeFileSync(config, 'task: fold.yaml\nmeasure: physics\nset: {physics.tests: [free fall, rest]}\nfactors: {simulator: {cloth: {simulator: {plugin: cloth}}, bullet: {simulator: {plugin: bullet}}}}\n');
  run(weft, 'ablate', config, '--quiet', '--out', out);
  const page = await open(path.join(out, 'report.html'));
  assert.match(await text(page, 'header'), /2 arms.*2 cases/s);
  const metric = 'free fall: within bounds', error = Object.keys(json('real-simulators', 'ablation.json').arms[0].metrics).find((name) => name.startsWith('free fall') && name !== metric);
  assert.equal(await shown(page, `bullet ${metric}`), '1.00');
  assert.match(await shown(page, `cloth ${error}`), /^0\.0*[1-9]/);
  assert.deepEqual(page.problems, []);
  await page.close();
}

/** An import with a finding that has a place, and names given by clicks. */
async function garmentPage() {
  const file = path.join(folder, 'sheet.obj'), out = path.join(folder, 'garment');
  const at = (i, j) => 7 * j + i + 1;
  const vertices = Array.from({ length: 49 }, (_, v) => `v ${(v % 7) * 0.1} ${Math.floor(v / 7) * 0.1} 0`);
  const faces = Array.from({ length: 36 }, (_, q) => [q % 6, Math.floor(q / 6)]).map(([i, j]) => `f ${at(i, j)} ${at(i + 1, j)} ${at(i + 1, j + 1)} ${at(i, j + 1)}`);
  writeFileSync(file, [...vertices, ...faces.filter((_, q) => q !== 14), ''].join('\n'));
  run(weft, 'garment', 'import', file, '--no-tuning', '--quiet', '--out', out);
  const page = await open(path.join(out, 'import.html'));
  await nextFrames(page);
  const { findings, named } = json('garment', 'import.json');
  assert.equal(await page.locator('#findings tbody tr').count(), findings.length);
  assert.match(await text(page, '#findings tr[data-pass="holes"]'), /1 hole of at most 6 edges filled/);
  assert.equal(await shown(page, 'mended'), String(findings.filter((one) => one.kind === 'mended').length));
  assert.match(await text(page, '#yaml'), new RegExp(`^name: sheet\nmesh: sheet.obj\nvertices:\n  left_bottom: ${named.left_bottom}\n`));
  assert.equal(await page.locator('.viewer canvas').count(), 2);
  await page.locator('#findings tr[data-pass="holes"] button').click();
  assert.equal(await page.locator('#findings tr[data-pass="holes"]').getAttribute('aria-selected'), 'true');

  // From above, the middle of the picture shows the middle of the sheet.
  await page.locator('#after button', { hasText: 'Top' }).click();
  await nextFrames(page);
  assert.ok((await look(page, '#after')).blue > 5000);
  const canvas = page.locator('#after canvas'), box = await canvas.boundingBox();
  assert.ok(await page.locator('#add-name').isDisabled());
  await canvas.click({ position: { x: box.width / 2, y: box.height / 2 } });
  const [, vertex, x, y] = (await text(page, '#chosen')).match(/Vertex (\d+) \(OBJ \d+\) at (\S+), (\S+), /);
  assert.ok(Math.abs(Number(x) - 0.3) < 0.15 && Math.abs(Number(y) - 0.3) < 0.15, `a click in the middle chose (${x}, ${y})`);
  await page.locator('#vertex-name').fill('2 words');
  assert.ok(await page.locator('#add-name').isDisabled());
  await page.locator('#vertex-name').fill('middle');
  await page.keyboard.press('Enter');
  assert.match(await text(page, '#yaml'), new RegExp(`  middle: ${vertex}\n`));
  await page.locator('button[aria-label="Remove the name middle"]').click();
  assert.doesNotMatch(await text(page, '#yaml'), /middle/);
  // A drag turns the view and names nothing.
  await page.mouse.move(box.x + 60, box.y + 60);
  await page.mouse.down();
  await page.mouse.move(box.x + 160, box.y + 90, { steps: 3 });
  await page.mouse.up();
  assert.match(await text(page, '#chosen'), new RegExp(`^Vertex ${vertex} `));
  assert.deepEqual(page.problems, []);
  await page.close();
  const shirt = path.join(folder, 'shirt.html');
  run(weft, 'garment', 'show', `${sources}/configs/garments/tshirt_two_layers.yaml`, '--quiet', '--out', shirt);
  const layered = await open(shirt);
  assert.match(await text(layered, '#yaml'), /^name: tshirt_two_layers\nmesh: tshirt_two_layers.obj\nrest:\n {2}from: mesh\nlayers: sides\nvertices:\n/);
  await layered.close();
  say('garment page: findings with their places, names by clicks, the YAML whole');
}

async function exports() {
  const session = path.join(folder, 'session');
  run(weft, 'export', session, '--to', 'gltf', '--to', 'csv', '--to', 'usd', '--to', 'obj', '--png', '0,last', '--size', '640x400', '--every', '24', '--quiet');
  const bundle = await build({ entryPoints: ['test/loaders.ts'], bundle: true, write: false, format: 'iife', logLevel: 'warning' });
  const file = path.join(folder, 'loaders.html');
  writeFileSync(file, `<!doctype html><html data-ready><link rel="icon" href="data:,"><script>${bundle.outputFiles[0].text}</script>`);
  const page = await open(file);
  const rows = readFileSync(path.join(session, 'csv', 'vertices.csv'), 'utf8').trim().split('\n').slice(1).map((row) => row.split(',').map(Number));
  const vertex = 262;
  const wanted = rows.filter((row) => row[2] === vertex);
  const found = await page.evaluate(([base64, v, times]) => window.lookGltf(base64, v, times),
    [readFileSync(path.join(session, 'session.glb')).toString('base64'), vertex, wanted.map((row) => row[1])]);
  assert.equal(found.targets, wanted.length - 1);
  assert.equal(found.vertices * wanted.length, rows.length);
  // The mixer wraps round at the very end of a clip, so the last time is left out.
  wanted.slice(0, -1).forEach((row, i) => {
    for (let axis = 0; axis < 3; ++axis) assert.ok(Math.abs(found.positions[i].local[axis] - row[3 + axis]) < 1e-4, `frame ${row[0]}: ${found.positions[i].local} against ${row}`);
    assert.ok(Math.abs(found.positions[i].world[1] - row[5]) < 1e-4, 'up is y');
  });
  const usd = readFileSync(path.join(session, 'session.usda'), 'utf8');
  assert.match(usd, /^#usda 1\.0\n/);
  const meshes = await page.evaluate((scene) => window.lookUsd(scene), usd);
  assert.deepEqual(meshes.map((mesh) => [mesh.name, mesh.corners]), [['tshirt', 3 * found.faces], ['goal', 3 * found.faces]]);
  const start = rows.filter((row) => row[0] === 0);
  assert.deepEqual(meshes[0].times, wanted.map((row) => row[0]));
  wanted.forEach((row, i) => {
    for (let axis = 0; axis < 3; ++axis) assert.ok(Math.abs(meshes[0].points[i][3 * vertex + axis] - row[3 + axis]) < 1e-6, `usd, frame ${row[0]}`);
  });
  for (const [axis, column] of [[0, 3], [1, 5]]) {
    const values = start.map((row) => row[column]);
    assert.ok(Math.abs(meshes[0].low[axis] - Math.min(...values)) < 1e-4 && Math.abs(meshes[0].high[axis] - Math.max(...values)) < 1e-4, `usd, axis ${axis}: ${JSON.stringify(meshes[0])}`);
  }
  assert.deepEqual(page.problems, []);
  await page.close();
  const flat = count(readFileSync(path.join(session, 'frame-0000.png')));
  assert.ok(flat.blue > 5000 && flat.orange < 400, JSON.stringify(flat));
  const still = pixelsOf(readFileSync(path.join(session, 'frame-0300.png')));
  assert.deepEqual([still.width, still.height], [640, 400]);
  const segments = readFileSync(path.join(session, 'csv', 'segments.csv'), 'utf8').trim().split('\n');
  assert.equal(segments.length, 21);
  assert.ok(Math.abs(Number(segments[20].split(',')[1]) - json('session', 'summary.json').error_mm) < 1e-3);
  say('exports: glTF and USD open in three.js, stills and tables are as they must be');
}

try {
  await sessionPage();
  await realSession();
  await evaluationPage();
  await physicsPages();
  await realPrediction();
  await realEvaluations();
  await ablationPage();
  await realAblation();
  await realSimulators();
  await garmentPage();
  await exports();
} finally {
  await context.close();
  rmSync(profile, { recursive: true, force: true });
}
