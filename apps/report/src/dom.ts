// Elements, and the theme.
export type Child = Node | string | null | undefined | false;
type Attributes = Record<string, string | number | boolean | null | undefined | ((event: any) => void)>;

export function h<K extends keyof HTMLElementTagNameMap>(tag: K, attributes: Attributes = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === 'function') element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, '');
    else if (value !== false && value != null) element.setAttribute(name, String(value));
  }
  element.append(...(children.filter((child) => child != null && child !== false) as (Node | string)[]));
  return element;
}

export const fixed = (value: number | null | undefined, digits = 1) =>
  value == null || !Number.isFinite(value) ? '–' : value.toFixed(digits).replace(/^-/, '−');

/** Three digits, of numbers of any size. */
export function significant(value: number | null | undefined): string {
  if (value == null || !Number.isFinite(value)) return '–';
  const size = Math.abs(value);
  const text = size !== 0 && (size < 1e-3 || size >= 1e5) ? value.toExponential(1) : String(Number(value.toPrecision(3)));
  return text.replaceAll('-', '−');
}

export function duration(seconds: number | undefined): string {
  if (seconds === undefined || !Number.isFinite(seconds)) return '–';
  if (seconds < 1) return `${Math.round(seconds * 1000)} ms`;
  if (seconds < 120) return `${fixed(seconds, seconds < 10 ? 2 : 1)} s`;
  return `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;
}

/** Name of a property for people. */
export const label = (name: string) => name.charAt(0).toUpperCase() + name.slice(1).replaceAll('_', ' ');

const listeners: (() => void)[] = [];
export const onTheme = (listener: () => void) => void listeners.push(listener);
export const isDark = () => getComputedStyle(document.documentElement).getPropertyValue('--dark').trim() === '1';
export const cssColour = (name: string) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

function remembered(): string {
  try {
    return localStorage.getItem('weft-theme') ?? 'auto';
  } catch {
    return 'auto';
  }
}

export function themeSwitch(): HTMLElement {
  const select = h('select', { 'aria-label': 'Colours of the page', id: 'theme' },
    ...['auto', 'light', 'dark'].map((name) => h('option', { value: name }, name === 'auto' ? 'System colours' : label(name))));
  const system = matchMedia('(prefers-color-scheme: dark)');
  const apply = () => {
    document.documentElement.dataset.theme = select.value !== 'auto' ? select.value : system.matches ? 'dark' : 'light';
    for (const listener of listeners) listener();
  };
  select.value = hashOptions().get('theme') ?? remembered();
  if (!select.value) select.value = 'auto';
  apply();
  select.addEventListener('change', () => {
    try {
      localStorage.setItem('weft-theme', select.value);
    } catch { /* a file:// page may have no storage */ }
    apply();
  });
  system.addEventListener('change', apply);
  return select;
}

/** The settings in the address: report.html#frame=120&theme=dark. */
export const hashOptions = () => new URLSearchParams(location.hash.slice(1));

export function section(id: string, title: string, note: Child, ...children: Child[]): HTMLElement {
  return h('section', { id, 'aria-labelledby': `${id}-title` }, h('h2', { id: `${id}-title` }, title), note ? h('p', { class: 'note' }, note) : null, ...children);
}
