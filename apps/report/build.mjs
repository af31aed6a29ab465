// Bundles the page into one file with a place for data, which weft fills in (framework/report/page_data.cpp).
//   node build.mjs OUTPUT.html
// Bundles figures.mjs into another one beside it, which draws the page's figures for papers.
import { mkdir, readFile, rename, writeFile } from 'node:fs/promises';
import { existsSync, readdirSync, readFileSync } from 'node:fs';
import path from 'node:path';
import { build } from 'esbuild';

const output = process.argv[2] ?? 'report.html';
const here = path.dirname(new URL(import.meta.url).pathname);
process.chdir(here);

const common = { bundle: true, minify: true, write: false, logLevel: 'warning', target: ['es2021', 'chrome100', 'firefox100', 'safari15.4'] };
const script = await build({ ...common, entryPoints: ['src/main.ts'], format: 'iife', legalComments: 'none', metafile: true });
const style = await build({ ...common, entryPoints: ['src/style.css'] });

// The licence of everything that is in the bundle, each text once.
const packages = new Set(
  Object.keys(script.metafile.inputs).flatMap((file) => file.match(/node_modules\/((?:@[^/]+\/)?[^/]+)/)?.[1] ?? []));
const notices = new Map();
for (const name of [...packages].sort()) {
  const folder = `node_modules/${name}`;
  const { version, license } = JSON.parse(readFileSync(`${folder}/package.json`, 'utf8'));
  const file = readdirSync(folder).find((entry) => /^licen[cs]e/i.test(entry));
  const text = file ? readFileSync(`${folder}/${file}`, 'utf8').trim() : `Licence: ${license}`;
  notices.set(text, [...(notices.get(text) ?? []), `${name} ${version}`]);
}
const notice = [...notices].map(([text, names]) => `${names.join(', ')}\n\n${text}`).join('\n\n').replaceAll('*/', '* /').replaceAll('<', '(').replaceAll('>', ')');

const template = await readFile('src/template.html', 'utf8');
const page = template
  .replace('/*style*/', () => style.outputFiles[0].text.trim())
  .replace('/*script*/', () => `${script.outputFiles[0].text.trim()}\n/* This page contains:\n\n${notice}\n*/`);
if (page.split('<!--weft-data-->').length !== 2) throw new Error('the template must have exactly one place for data');

if (!existsSync(path.dirname(path.resolve(output)))) await mkdir(path.dirname(path.resolve(output)), { recursive: true });
const figures = await build({ ...common, entryPoints: ['figures.mjs'], format: 'esm', platform: 'node', target: 'node18', loader: { '.css': 'text' }, legalComments: 'none' });
const program = path.join(path.dirname(output), 'figures.mjs');
await writeFile(`${program}.tmp`, `${figures.outputFiles[0].text.trim()}\n/* This program contains:\n\n${notice}\n*/\n`);
await rename(`${program}.tmp`, program);
await writeFile(`${output}.tmp`, page);
await rename(`${output}.tmp`, output);
console.log(`${output}: ${(page.length / 1e6).toFixed(2)} MB`);
