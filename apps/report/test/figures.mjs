// Figures for papers of made-up results: node test/figures.mjs MAKE_RESULTS FIGURES FOLDER
import assert from 'node:assert/strict';
import { execFileSync, spawnSync } from 'node:child_process';
import { existsSync, readFileSync, readdirSync, rmSync } from 'node:fs';
import path from 'node:path';

const [makeResults, program, folder] = process.argv.slice(2);
const hasPdf = spawnSync('rsvg-convert', ['--version']).status === 0;
rmSync(folder, { recursive: true, force: true });
for (const kind of ['evaluation', 'ablation', 'physics']) {
  execFileSync(makeResults, [kind, path.join(folder, kind)], { stdio: 'ignore' });
  execFileSync(process.execPath, [program, path.join(folder, kind), 'svg', ...(hasPdf ? ['pdf'] : [])], { stdio: 'inherit' });
}
const text = (...parts) => readFileSync(path.join(folder, ...parts), 'utf8');
const names = (kind) => readdirSync(path.join(folder, kind, 'figures')).filter((name) => name.endsWith('.svg')).map((name) => name.slice(0, -4));

assert.ok(!existsSync(path.join(folder, 'physics', 'figures')), 'the physics suite has tables alone');
assert.deepEqual(names('evaluation'), ['estimation-bend', 'estimation-calibration', 'estimation-friction', 'estimation-stretch', 'estimation-thickness', 'planning', 'prediction-coverage', 'prediction-error']);
for (const kind of ['evaluation', 'ablation']) {
  for (const name of names(kind)) {
    const svg = text(kind, 'figures', `${name}.svg`);
    assert.match(svg, /^<svg xmlns="http:\/\/www\.w3\.org\/2000\/svg" [^>]*width="\d+" height="\d+"/);
    assert.ok(!/var\(|currentColor|NaN|undefined/.test(svg), `${name}: a colour or a number is missing`);
    // Every element that begins ends.
    const open = [];
    for (const [, end, tag] of svg.matchAll(/<(\/?)(\w+)/g)) end ? assert.equal(open.pop(), tag) : open.push(tag);
    assert.deepEqual(open, []);
    if (hasPdf) assert.equal(text(kind, 'figures', `${name}.pdf`).slice(0, 5), '%PDF-');
  }
}
// The data beside a figure are what it shows.
const { arms } = JSON.parse(text('ablation', 'ablation.json'));
const [head, ...rows] = text('ablation', 'figures', 'ablation-error_mm.csv').trimEnd().split('\n');
assert.equal(head, 'arm,n,mean,low_95,high_95');
const shown = arms.filter((arm) => arm.metrics.error_mm?.mean != null);
assert.deepEqual(rows.map((row) => Number(row.split(',').at(-3))), shown.map((arm) => arm.metrics.error_mm.mean));
const svg = text('ablation', 'figures', 'ablation-error_mm.svg');
for (const arm of shown) assert.ok(svg.includes(`>${arm.name}</text>`), arm.name);
const planning = JSON.parse(text('evaluation', 'planning.json'));
assert.equal(text('evaluation', 'figures', 'planning.csv').trimEnd().split('\n').length - 1, planning.cases.filter((one) => one.error_mm !== null).length);
console.log(`${names('evaluation').length + names('ablation').length} figures, ${hasPdf ? 'with' : 'without'} PDF`);
