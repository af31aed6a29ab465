// Play, pause and scrub over frames and segments.
import { fixed, h } from './dom';

const kTick = 8;  // px: half a slider thumb, by which the track is shorter than the slider

function icon(path: string): SVGElement {
  const svg = document.createElementNS('http://www.w3.org/2000/svg', 'svg');
  for (const [name, value] of Object.entries({ viewBox: '0 0 16 16', width: '16', height: '16', 'aria-hidden': 'true', fill: 'currentColor', stroke: 'currentColor', 'stroke-width': '1.5' })) svg.setAttribute(name, value);
  const shape = document.createElementNS('http://www.w3.org/2000/svg', 'path');
  shape.setAttribute('d', path);
  svg.append(shape);
  return svg;
}

export class Player {
  readonly element: HTMLElement;
  private readonly range: HTMLInputElement;
  private readonly where = h('output', { class: 'where', id: 'where' });
  private readonly button: HTMLButtonElement;
  private readonly speed: HTMLSelectElement;
  private position: number;
  private playing = false;
  private last = 0;

  /** @param boundaries frames at which segments end; the last of them may be the settled shape. */
  constructor(private readonly frames: number, private readonly frameSeconds: number, private readonly boundaries: number[],
              private readonly describe: (frame: number) => string, private readonly show: (position: number) => void) {
    this.position = frames - 1;
    this.range = h('input', { type: 'range', min: 0, max: frames - 1, step: 1, value: this.position, 'aria-label': 'Frame', id: 'scrub' });
    this.range.addEventListener('input', () => {
      this.pause();
      this.seek(Number(this.range.value));
    });
    this.button = h('button', { class: 'primary', id: 'play', onclick: () => this.toggle() }, 'Play');
    this.speed = h('select', { 'aria-label': 'Speed' }, ...[0.1, 0.25, 0.5, 1, 2, 4].map((s) => h('option', { value: s, selected: s === 1 }, `${s}×`)));
    const ticks = h('div', { class: 'ticks', 'aria-hidden': 'true' }, ...boundaries.map((frame) => h('i', { style: `left:${(100 * frame) / (frames - 1)}%` })));
    ticks.style.left = ticks.style.right = `${kTick}px`;
    this.element = h('div', { class: 'transport', role: 'group', 'aria-label': 'Playback' },
      h('div', { class: 'scrub' }, this.range, ticks),
      this.button,
      h('button', { onclick: () => this.jump(-1), title: 'Back one segment ([)', 'aria-label': 'Back one segment', id: 'previous' }, icon('M4 3v10M13 3 6 8l7 5z')),
      h('button', { onclick: () => this.jump(1), title: 'Forward one segment (])', 'aria-label': 'Forward one segment', id: 'next' }, icon('M12 3v10M3 3l7 5-7 5z')),
      this.speed, this.where);
    document.addEventListener('keydown', (event) => this.key(event));
  }

  get frame() {
    return Math.round(this.position);
  }
  seek(position: number) {
    this.position = Math.min(Math.max(position, 0), this.frames - 1);
    this.refresh();
  }
  toggle() {
    if (this.playing) this.pause();
    else this.play();
  }
  pause() {
    this.playing = false;
    this.button.textContent = 'Play';
  }
  /** To the segment boundary before or after. */
  jump(direction: -1 | 1) {
    this.pause();
    const stops = [0, ...this.boundaries];
    const here = this.position;
    const target = direction < 0 ? [...stops].reverse().find((stop) => stop < here - 0.01) : stops.find((stop) => stop > here + 0.01);
    if (target !== undefined) this.seek(target);
  }

  private play() {
    if (this.position >= this.frames - 1) this.position = 0;
    this.playing = true;
    this.button.textContent = 'Pause';
    this.last = performance.now();
    requestAnimationFrame((now) => this.step(now));
  }
  private step(now: number) {
    if (!this.playing) return;
    this.position += (Math.max(0, now - this.last) / 1000 / this.frameSeconds) * Number(this.speed.value);
    this.last = now;
    if (this.position >= this.frames - 1) {
      this.position = this.frames - 1;
      this.pause();
    }
    this.refresh();
    if (this.playing) requestAnimationFrame((next) => this.step(next));
  }
  private refresh() {
    this.range.value = String(this.frame);
    const text = this.describe(this.frame);
    this.range.setAttribute('aria-valuetext', text);
    this.where.textContent = text;
    this.show(this.position);
  }
  private key(event: KeyboardEvent) {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey || target.closest('select, textarea, input:not([type=range]), summary')) return;
    if (event.key === ' ' && !target.closest('button')) this.toggle();
    else if (event.key === '[') this.jump(-1);
    else if (event.key === ']') this.jump(1);
    else if (event.key === ',') { this.pause(); this.seek(this.frame - 1); }
    else if (event.key === '.') { this.pause(); this.seek(this.frame + 1); }
    else return;
    event.preventDefault();
  }
}

export const seconds = (frame: number, frameSeconds: number) => `${fixed(frame * frameSeconds, 2)} s`;
