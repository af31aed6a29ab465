// As much of a document as Observable Plot needs to draw an SVG outside of a browser, and the text of what it drew.
const kEscapes: Record<string, string> = { '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' };
const escaped = (text: string) => text.replace(/[&<>"]/g, (c) => kEscapes[c]);

class PlainText {
  parentNode: PlainElement | null = null;
  constructor(public data: string) {}
  get outer() {
    return escaped(this.data);
  }
}

class PlainElement {
  parentNode: PlainElement | null = null;
  childNodes: (PlainElement | PlainText)[] = [];
  private attributes = new Map<string, string>();
  readonly style = {
    setProperty: (name: string, value: string) => this.setAttribute('style', `${this.getAttribute('style') ?? ''}${name}:${value};`),
    removeProperty: () => undefined,
    getPropertyValue: () => '',
  };
  constructor(readonly ownerDocument: PlainDocument, readonly namespaceURI: string, readonly tagName: string) {}
  getAttribute(name: string) {
    return this.attributes.get(name) ?? null;
  }
  setAttribute(name: string, value: unknown) {
    this.attributes.set(name, String(value));
  }
  setAttributeNS(_space: string, name: string, value: unknown) {
    this.setAttribute(name, value);
  }
  hasAttribute(name: string) {
    return this.attributes.has(name);
  }
  removeAttribute(name: string) {
    this.attributes.delete(name);
  }
  insertBefore<T extends PlainElement | PlainText>(child: T, next: PlainElement | PlainText | null): T {
    child.parentNode?.removeChild(child);
    const at = next ? this.childNodes.indexOf(next) : -1;
    this.childNodes.splice(at < 0 ? this.childNodes.length : at, 0, child);
    child.parentNode = this;
    return child;
  }
  appendChild<T extends PlainElement | PlainText>(child: T): T {
    return this.insertBefore(child, null);
  }
  append(...children: (PlainElement | PlainText | string)[]) {
    for (const child of children) this.appendChild(typeof child === 'string' ? new PlainText(child) : child);
  }
  removeChild(child: PlainElement | PlainText) {
    this.childNodes = this.childNodes.filter((one) => one !== child);
    child.parentNode = null;
  }
  remove() {
    this.parentNode?.removeChild(this);
  }
  get children() {
    return this.childNodes.filter((one): one is PlainElement => one instanceof PlainElement);
  }
  get firstChild() {
    return this.childNodes[0] ?? null;
  }
  addEventListener() {}  // nobody points at a file
  dispatchEvent() {}
  hasChildNodes() {
    return this.childNodes.length > 0;
  }
  set textContent(text: string) {
    this.childNodes = [];
    this.append(String(text));
  }
  get outer(): string {
    const attributes = [...this.attributes].map(([name, value]) => ` ${name}="${escaped(value)}"`).join('');
    return `<${this.tagName}${attributes}>${this.childNodes.map((one) => one.outer).join('')}</${this.tagName}>`;
  }
}

class PlainDocument {
  readonly defaultView = { Event };
  readonly documentElement = new PlainElement(this, 'http://www.w3.org/1999/xhtml', 'html');
  createElementNS(space: string, name: string) {
    return new PlainElement(this, space, name);
  }
  createElement(name: string) {
    return this.createElementNS(this.documentElement.namespaceURI, name);
  }
  createTextNode(text: string) {
    return new PlainText(text);
  }
}

export const plainDocument = () => new PlainDocument() as unknown as Document;
/** The element as a file holds it. */
export const sourceOf = (element: unknown) => (element as PlainElement).outer;
