// Writes the figures of a folder of results for papers: node figures.mjs FOLDER FORMAT...
// FOLDER/figures gets NAME.csv with what a figure shows, and NAME.svg and NAME.pdf as far as FORMAT (svg, pdf) asks for them.
// PDF is made by rsvg-convert. build.mjs bundles this file; weft runs it.
import { execFileSync } from 'node:child_process';
import { existsSync, mkdirSync, readFileSync, renameSync, writeFileSync } from 'node:fs';
import path from 'node:path';
import { paperFigures } from './src/paper';
import style from './src/style.css';

const [folder, ...formats] = process.argv.slice(2);
const results = {};
for (const name of ['ablation', 'planning', 'estimation', 'prediction']) {
  const file = path.join(folder, `${name}.json`);
  if (existsSync(file)) results[name] = JSON.parse(readFileSync(file, 'utf8'));
}
// The colours of the light theme.
const colours = Object.fromEntries([...style.slice(0, style.indexOf('}')).matchAll(/--([\w-]+):\s*(#\w+)/g)].map((match) => [match[1], match[2]]));

const out = path.join(folder, 'figures');
/** A file that appears whole or not at all. */
const write = (name, data) => {
  const file = path.join(out, name);
  writeFileSync(`${file}.tmp`, data);
  renameSync(`${file}.tmp`, file);
};
const figures = paperFigures(results, colours);
if (figures.length) mkdirSync(out, { recursive: true });
for (const { name, svg, csv } of figures) {
  write(`${name}.csv`, csv);
  if (formats.includes('svg')) write(`${name}.svg`, svg);
  if (formats.includes('pdf')) write(`${name}.pdf`, execFileSync('rsvg-convert', ['--format=pdf'], { input: svg, maxBuffer: 1 << 28 }));
}
