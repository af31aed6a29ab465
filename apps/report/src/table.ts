// A table that sorts by any column: click a heading, or press Enter on it.
import { h } from './dom';

export interface Column<Row> {
  id: string;
  head: string;
  /** What rows are sorted by; those without a value (NaN) come last either way. */
  value: (row: Row) => number | string;
  /** What is shown; default: the value. */
  cell?: (row: Row) => Node | string;
  numeric?: boolean;
}

export interface TableOptions<Row> {
  id: string;
  rows: () => Row[];
  columns: () => Column<Row>[];
  sortBy: string;
  descending?: boolean;
  rowClass?: (row: Row) => string;
  /** Cells are named `${name(row)} ${column.id}`, for tests and scripts. */
  name?: (row: Row) => string;
  /** After a heading was clicked. */
  onSort?: () => void;
}

export interface Table<Row> {
  element: HTMLElement;
  sorted(): Row[];
  refresh(): void;
}

export function sortableTable<Row>({ id, rows, columns, sortBy, descending, rowClass, name, onSort }: TableOptions<Row>): Table<Row> {
  let by = sortBy, up = !descending;
  const head = h('tr', {}), body = h('tbody', {});
  const sorted = () => {
    const column = columns().find((one) => one.id === by) ?? columns()[0];
    return [...rows()].sort((a, b) => {
      const x = column.value(a), y = column.value(b);
      if (Number.isNaN(x) || Number.isNaN(y)) return Number(Number.isNaN(x)) - Number(Number.isNaN(y));
      const order = typeof x === 'number' && typeof y === 'number' ? (x === y ? 0 : x - y) : String(x).localeCompare(String(y), 'en', { numeric: true });
      return up ? order : -order;
    });
  };
  const refresh = () => {
    const shown = columns();
    head.replaceChildren(...shown.map((column) => h('th', {
      scope: 'col', class: column.numeric ? '' : 'text', 'aria-sort': column.id === by ? (up ? 'ascending' : 'descending') : null,
    }, h('button', {
      'data-sort': column.id,
      onclick: () => {
        up = by === column.id ? !up : true;
        by = column.id;
        refresh();
        head.querySelector<HTMLElement>(`[data-sort="${CSS.escape(column.id)}"]`)?.focus();
        onSort?.();
      },
    }, column.head))));
    body.replaceChildren(...sorted().map((row) => h('tr', { class: rowClass?.(row) ?? '' }, ...shown.map((column) =>
      h('td', { class: column.numeric ? '' : 'text', 'data-key': name ? `${name(row)} ${column.id}` : null }, column.cell?.(row) ?? String(column.value(row)))))));
  };
  refresh();
  // A region that scrolls must be reachable by key.
  return { element: h('div', { class: 'scroll', tabindex: 0, role: 'region', 'aria-label': 'Table' }, h('table', { id }, h('thead', {}, head), body)), sorted, refresh };
}
