// One colour map for everything that is coloured by a number: viridis, which reads the same with any colour vision.
import { scale } from '@observablehq/plot';
import { h } from './dom';

const viridis = scale({ color: { type: 'linear', scheme: 'viridis', domain: [0, 1] } })!;
const rgb = (t: number) => {
  const colour = viridis.apply(t) as string;
  const hex = colour.match(/^#(..)(..)(..)$/);
  return hex ? hex.slice(1).map((digits) => parseInt(digits, 16)) : colour.match(/\d+/g)!.map(Number);
};

/** [256, 4] bytes. */
export function colourMap(): Uint8Array {
  const bytes = new Uint8Array(256 * 4);
  for (let i = 0; i < 256; ++i) bytes.set([...rgb(i / 255).slice(0, 3), 255], 4 * i);
  return bytes;
}

function gradient(): string {
  const stops = Array.from({ length: 9 }, (_, i) => `rgb(${rgb(i / 8).slice(0, 3).join(' ')})`);
  return `linear-gradient(to right, ${stops.join(', ')})`;
}

/** What the colours mean, for an element of class `legend`. */
export const colourLegend = (title: string, range: number): (Node | string)[] => [
  title, h('div', { class: 'bar', style: `background:${gradient()}` }),
  h('div', { class: 'ends' }, h('span', {}, '0'), h('span', {}, String(range / 2)), h('span', {}, `≥ ${range}`))];

/** A round number at or above the value. */
export function niceCeiling(value: number): number {
  if (!(value > 0)) return 1;
  const power = 10 ** Math.floor(Math.log10(value));
  return [1, 2, 3, 5, 10].map((m) => m * power).find((nice) => nice >= value * 0.999)!;
}
