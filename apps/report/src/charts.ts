// Figures as SVG by Observable Plot: they redraw when their width changes, and read their colours from the page.
import * as Plot from '@observablehq/plot';
import { h } from './dom';

export interface ChartOptions {
  height?: number;
  /** Where a click in the figure leads, in units of its x axis. */
  seek?: (x: number) => void;
}

export interface Chart {
  element: HTMLElement;
  redraw(): void;
  /** Moves the line that marks where playback is; null hides it. */
  mark(x: number | null): void;
}

type Figure = (SVGElement | HTMLElement) & Plot.Plot;

export function chart(label: string, build: (width: number) => Plot.PlotOptions, options: ChartOptions = {}): Chart {
  const element = h('div', { class: `chart${options.seek ? ' seek' : ''}` });
  let figure: Figure | null = null;
  let cursor: SVGLineElement | null = null;
  let scale: Plot.Scale | undefined;
  let marked: number | null = null;
  let width = 0;

  const place = () => {
    const x = scale;
    if (!cursor || !x) return;
    cursor.style.display = marked === null ? 'none' : '';
    if (marked === null) return;
    const [low, high] = x.domain as number[];
    const at = String(x.apply(Math.min(Math.max(marked, low), high)));
    cursor.setAttribute('x1', at);
    cursor.setAttribute('x2', at);
  };
  const redraw = () => {
    if (width === 0) return;
    figure = Plot.plot({
      width, height: options.height ?? 220, marginLeft: 46, marginRight: 14, marginBottom: 36, marginTop: 26,
      style: { background: 'transparent', fontSize: '12px', fontFamily: 'inherit' },
      ariaLabel: label, ...build(width),
    }) as Figure;
    scale = figure.scale('x');
    const svg = figure.tagName === 'svg' ? figure : figure.querySelector('svg')!;
    svg.setAttribute('role', 'img');
    if (options.seek) {
      const y = figure.scale('y')?.range as number[];
      cursor = document.createElementNS('http://www.w3.org/2000/svg', 'line');
      cursor.setAttribute('y1', String(Math.min(...y)));
      cursor.setAttribute('y2', String(Math.max(...y)));
      cursor.setAttribute('stroke', 'var(--accent)');
      cursor.setAttribute('stroke-width', '1.5');
      svg.append(cursor);
      svg.addEventListener('click', (event) => {
        const box = svg.getBoundingClientRect();
        if (scale?.invert) options.seek!(scale.invert(((event as MouseEvent).clientX - box.left) * (width / box.width)) as number);
      });
      place();
    }
    element.replaceChildren(figure);
  };
  new ResizeObserver(([entry]) => {
    const next = Math.floor(entry.contentRect.width);
    if (next === width || next === 0) return;
    width = next;
    redraw();
  }).observe(element);
  return {
    element, redraw,
    mark(x) {
      marked = x;
      place();
    },
  };
}

export interface KeyEntry { text: string; colour: string; style?: 'line' | 'dashed' }
export const key = (...entries: KeyEntry[]) =>
  h('ul', { class: 'key' }, ...entries.map(({ text, colour, style }) =>
    h('li', {}, h('span', { class: `swatch ${style ? 'line' : ''} ${style === 'dashed' ? 'dashed' : ''}`, style: style ? `border-color:${colour}` : `background:${colour}` }), text)));

/** Whole numbers for an axis that counts things, no more than fit. */
export function wholeTicks(low: number, high: number, width: number): number[] {
  const most = Math.max(2, Math.floor(width / 44));
  const step = [1, 2, 5, 10, 20, 25, 50, 100, 200].find((s) => (high - low) / s <= most) ?? 500;
  const ticks: number[] = [];
  for (let t = Math.ceil(low / step) * step; t <= high; t += step) ticks.push(t);
  return ticks;
}

/** Fig. 4: the band c +- w/2 of one property over segments, c as a line, the true value dotted. */
export function materialChart(property: string, knowledge: { centre: number[]; width: number[] }[], index: number, truth: number | undefined,
                              options: ChartOptions = {}): Chart {
  const colour = `var(--${property})`;
  const rows = knowledge.map(({ centre, width }, segment) => ({
    segment, centre: centre[index],
    low: Math.max(0, centre[index] - width[index] / 2), high: Math.min(1, centre[index] + width[index] / 2),
  }));
  return chart(`Knowledge of ${property} over segments`, (width) => ({
    marginLeft: 32, marginTop: 10,
    x: { domain: [0, Math.max(1, rows.length - 1)], ticks: wholeTicks(0, rows.length - 1, width), tickFormat: 'd', label: 'segments executed' },
    y: { domain: [0, 1], ticks: [0, 0.5, 1], label: null },
    marks: [
      Plot.ruleY([0, 1], { stroke: 'var(--line)' }),
      Plot.areaY(rows, { x: 'segment', y1: 'low', y2: 'high', fill: colour, fillOpacity: 0.22 }),
      Plot.lineY(rows, { x: 'segment', y: 'low', stroke: colour, strokeOpacity: 0.6 }),
      Plot.lineY(rows, { x: 'segment', y: 'high', stroke: colour, strokeOpacity: 0.6 }),
      Plot.lineY(rows, { x: 'segment', y: 'centre', stroke: colour, strokeWidth: 2.2, marker: rows.length === 1 ? 'dot' : undefined }),
      ...(truth === undefined ? [] : [Plot.ruleY([truth], { stroke: 'var(--ink)', strokeWidth: 1.6, strokeDasharray: '1.5,4', strokeLinecap: 'round' })]),
    ],
  }), { height: 150, ...options });
}

export { Plot };
