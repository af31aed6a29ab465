// The 3D view: one garment, overlays of it, paths, a ground grid. Draws when something changed, not all the time.
import {
  BufferAttribute, BufferGeometry, CanvasTexture, Color, DataTexture, DoubleSide, Group, KeepStencilOp,
  LinearSRGBColorSpace, LineBasicMaterial, LineSegments, Matrix4, Mesh, MeshBasicMaterial, NotEqualStencilFunc, PerspectiveCamera, Raycaster, ReplaceStencilOp,
  RGBAFormat, Scene, ShaderMaterial, SphereGeometry, Spherical, Sprite, SpriteMaterial, Vector2, Vector3, WebGLRenderer,
} from 'three';
import { OrbitControls } from 'three/examples/jsm/controls/OrbitControls.js';
import { Line2 } from 'three/examples/jsm/lines/Line2.js';
import { LineGeometry } from 'three/examples/jsm/lines/LineGeometry.js';
import { LineMaterial } from 'three/examples/jsm/lines/LineMaterial.js';
import { colourMap } from './colours';
import { cssColour, h, onTheme } from './dom';

const kVertexShader = `
attribute float value;
uniform float recede;
varying vec3 vNormal;
varying float vValue;
void main() {
  vNormal = normal;
  vValue = value;
  vec3 seen = (modelViewMatrix * vec4(position, 1.0)).xyz;
  gl_Position = projectionMatrix * vec4(seen * (1.0 + recede / length(seen)), 1.0);
}`;
const kFragmentShader = `
uniform vec3 front, back, eye;
uniform float opacity, range;
uniform bool coloured;
uniform sampler2D map;
varying vec3 vNormal;
varying float vValue;
void main() {
  vec3 n = normalize(gl_FrontFacing ? vNormal : -vNormal);
  float light = 0.62 + 0.27 * max(0.0, dot(n, vec3(0.28, -0.36, 0.89))) + 0.19 * abs(dot(n, eye));
  vec3 base = coloured ? texture2D(map, vec2(clamp(vValue / range, 0.0, 1.0) * 0.996 + 0.002, 0.5)).rgb : (gl_FrontFacing ? front : back);
  gl_FragColor = vec4(min(base * light, 1.0), opacity);
}`;

const kLabelHeight = 0.045;  // of the scale along the grid, as a tangent of the angle it fills

// Grid and shadow lie under everything, and the camera stays above them. So they are drawn first, without depth, and
// rounding never hides cloth that lies a millimetre above them.
const kOnTheGround = { depthTest: false, depthWrite: false };

/** A colour as the bytes on the screen, since the shader writes its inputs unchanged. */
function screenColour(name: string): Color {
  return new Color().setStyle(cssColour(name), LinearSRGBColorSpace);
}

function surfaceMaterial(opacity: number): ShaderMaterial {
  return new ShaderMaterial({
    vertexShader: kVertexShader, fragmentShader: kFragmentShader, side: DoubleSide, transparent: opacity < 1,
    polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1,
    uniforms: {
      front: { value: new Color() }, back: { value: new Color() }, eye: { value: new Vector3(0, 0, 1) }, opacity: { value: opacity },
      // The cloth hides overlays within a few millimetres of it.
      recede: { value: opacity < 1 ? 0.006 : 0 }, range: { value: 1 }, coloured: { value: false }, map: { value: null },
    },
  });
}

/** A shape of the garment. */
class Surface {
  readonly geometry = new BufferGeometry();
  readonly material: ShaderMaterial;
  readonly mesh: Mesh;
  readonly positions: Float32Array;
  private readonly values: Float32Array;
  private readonly normals: Float32Array;

  constructor(private readonly faces: Uint32Array, vertices: number, readonly colours: [string, string], opacity: number) {
    this.positions = new Float32Array(vertices * 3);
    this.normals = new Float32Array(vertices * 3);
    this.values = new Float32Array(vertices);
    this.geometry.setAttribute('position', new BufferAttribute(this.positions, 3));
    this.geometry.setAttribute('normal', new BufferAttribute(this.normals, 3));
    this.geometry.setAttribute('value', new BufferAttribute(this.values, 1));
    this.geometry.setIndex(new BufferAttribute(faces, 1));
    this.material = surfaceMaterial(opacity);
    this.mesh = new Mesh(this.geometry, this.material);
    this.mesh.frustumCulled = false;
  }

  setPositions(positions: Float32Array) {
    this.positions.set(positions);
    const { faces, normals, positions: p } = this;
    normals.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const i of [a, b, c]) {
        normals[i] += x;
        normals[i + 1] += y;
        normals[i + 2] += z;
      }
    }
    this.geometry.attributes.position.needsUpdate = true;
    this.geometry.attributes.normal.needsUpdate = true;
  }

  setValues(values: Float32Array | null, range: number) {
    this.material.uniforms.coloured.value = values !== null;
    this.material.uniforms.range.value = range;
    if (values) {
      this.values.set(values);
      this.geometry.attributes.value.needsUpdate = true;
    }
  }

  paint() {
    this.material.uniforms.front.value = screenColour(this.colours[0]);
    this.material.uniforms.back.value = screenColour(this.colours[1]);
  }
}

export type Overlay = 'goal' | 'prediction';

export class Viewer {
  readonly element: HTMLElement;
  readonly canvas: HTMLCanvasElement | null = null;
  /** Frames drawn so far, which tests read. */
  drawn = 0;
  private renderer: WebGLRenderer | null = null;
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(35, 1, 0.02, 50);
  private controls!: OrbitControls;
  private readonly cloth: Surface;
  private readonly overlays: Record<Overlay, Surface>;
  private readonly shadow: Mesh;
  private readonly edges: LineSegments;
  private readonly ground = new Group();
  private readonly lines = new Map<string, { line: Line2; colour: string }[]>();
  private readonly hands: Mesh[] = [];
  private readonly marks = new Group();
  /** Called with the vertex that a click (without a drag) hits. */
  onPick: ((vertex: number) => void) | null = null;
  private readonly extent: Vector3[] = [];
  /** The view until somebody turns it. */
  private preset: 'reset' | 'side' | 'top' | null = 'reset';
  private groundKey = '';
  private queued = false;
  private ratio = Math.min(window.devicePixelRatio || 1, 2);
  private slow = 0;
  private lastDraw = 0;

  /** @param goal another mesh of the goal than that of the cloth. */
  constructor(faces: Uint32Array, vertices: number, name: string, goal = { faces, vertices }) {
    this.cloth = new Surface(faces, vertices, ['front', 'back'], 1);
    this.overlays = {
      goal: new Surface(goal.faces, goal.vertices, ['goal', 'goal'], 0.42),
      prediction: new Surface(faces, vertices, ['prediction', 'prediction'], 0.42),
    };
    this.shadow = new Mesh(this.cloth.geometry, new MeshBasicMaterial({ side: DoubleSide, ...kOnTheGround }));
    this.shadow.renderOrder = -1;
    this.edges = new LineSegments(edgeGeometry(faces, this.cloth.geometry), new LineBasicMaterial({ transparent: true, opacity: 0.6 }));
    this.element = h('div', { class: 'viewer' });
    const canvas = h('canvas', { tabindex: 0, role: 'application', 'aria-roledescription': '3D view', 'aria-label': `3D view of the ${name}. Arrow keys turn, shift and arrow keys move, plus and minus zoom, R resets.` });
    const drawnBy = webGl();
    if (!drawnBy) {
      this.element.append(h('p', { class: 'message' }, 'This browser offers no WebGL, which the 3D view needs. The figures and tables below do not.'));
      return;
    }
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: !drawnBy.software, stencil: true, powerPreference: 'high-performance' });
    this.element.append(canvas);

    this.shadow.matrixAutoUpdate = false;
    this.shadow.matrix = new Matrix4().makeScale(1, 1, 0);
    for (const object of [this.shadow, this.edges]) object.frustumCulled = false;
    this.edges.visible = false;
    for (const overlay of Object.values(this.overlays)) {
      overlay.mesh.visible = false;
      overlay.mesh.renderOrder = 2;
      // Each pixel is tinted once, however many layers lie behind it: a translucent fold stays readable.
      const material = overlay.material;
      material.depthWrite = false;
      material.stencilWrite = true;
      material.stencilRef = overlay === this.overlays.goal ? 1 : 2;
      material.stencilFunc = NotEqualStencilFunc;
      material.stencilZPass = ReplaceStencilOp;
      material.stencilFail = KeepStencilOp;
      material.stencilZFail = KeepStencilOp;
    }
    this.scene.add(this.ground, this.marks, this.shadow, this.cloth.mesh, this.edges, this.overlays.goal.mesh, this.overlays.prediction.mesh);

    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.maxPolarAngle = Math.PI * 0.495;
    this.controls.minDistance = 0.1;
    this.controls.maxDistance = 8;
    this.controls.zoomSpeed = 1.2;
    this.controls.addEventListener('change', () => this.invalidate());
    this.controls.addEventListener('start', () => (this.preset = null));
    // The wheel scrolls the page until the view is clicked or tabbed to.
    this.controls.enableZoom = false;
    canvas.addEventListener('focus', () => (this.controls.enableZoom = true));
    canvas.addEventListener('blur', () => (this.controls.enableZoom = false));
    canvas.addEventListener('pointerdown', () => canvas.focus({ preventScroll: true }));
    canvas.addEventListener('keydown', (event) => this.key(event));
    const pressed = new Vector2();
    canvas.addEventListener('pointerdown', (event) => pressed.set(event.clientX, event.clientY));
    canvas.addEventListener('click', (event) => {
      if (Math.hypot(event.clientX - pressed.x, event.clientY - pressed.y) < 4) this.pick(event);
    });
    this.element.append(h('div', { class: 'views' },
      h('button', { onclick: () => this.view('side'), title: 'From the side (2)' }, 'Side'),
      h('button', { onclick: () => this.view('top'), title: 'From above (3)' }, 'Top'),
      h('button', { onclick: () => this.view('reset'), title: 'Reset the view (R)' }, 'Reset'),
      h('button', { onclick: () => this.save(), title: 'Save this view as a PNG file' }, 'Save PNG')));
    new ResizeObserver(() => this.resize()).observe(this.element);
    onTheme(() => this.paint());
  }

  /** Fits the grid to everything that will be shown (shapes and paths, [n, 3] each), and the camera unless somebody turned it. */
  fit(all: Float32Array[]) {
    const low = new Vector3(Infinity, Infinity, Infinity), high = new Vector3(-Infinity, -Infinity, -Infinity), point = new Vector3();
    for (const positions of all) {
      for (let i = 0; i < positions.length; i += 3) {
        point.fromArray(positions, i);
        low.min(point);
        high.max(point);
      }
    }
    this.extent.length = 0;
    for (const positions of all) {
      for (let i = 0; i < positions.length; i += 3) this.extent.push(new Vector3().fromArray(positions, i));
    }
    if (!this.renderer) return;
    this.makeGround(low, high);
    this.paint();
    if (this.preset) this.view(this.preset);
  }

  setCloth(positions: Float32Array) {
    this.cloth.setPositions(positions);
    this.invalidate();
  }
  setColours(values: Float32Array | null, range: number) {
    this.cloth.setValues(values, range);
    this.invalidate();
  }
  setOverlay(name: Overlay, positions: Float32Array | null) {
    const overlay = this.overlays[name];
    overlay.mesh.visible = positions !== null;
    if (positions) overlay.setPositions(positions);
    this.invalidate();
  }
  setEdges(visible: boolean) {
    this.edges.visible = visible;
    this.invalidate();
  }
  setHands(points: Float32Array | null) {
    if (!this.renderer) return;
    const count = points ? points.length / 3 : 0;
    while (this.hands.length < count) {
      const hand = new Mesh(new SphereGeometry(0.009, 16, 12), new MeshBasicMaterial());
      this.hands.push(hand);
      this.scene.add(hand);
      this.paint();
    }
    this.hands.forEach((hand, i) => {
      hand.visible = i < count;
      if (i < count) hand.position.fromArray(points!, 3 * i);
    });
    this.invalidate();
  }

  /** Balls at places, with a text beside those that have one. */
  setMarks(marks: { at: number[]; text: string }[]) {
    if (!this.renderer) return;
    this.marks.clear();
    const size = this.extent.length ? new Vector3().copy(this.extent[0]).distanceTo(this.extent[this.extent.length >> 1]) : 1;
    for (const { at, text } of marks) {
      const ball = new Mesh(new SphereGeometry(Math.min(Math.max(0.012 * size, 0.003), 0.012), 16, 12), new MeshBasicMaterial({ depthTest: false }));
      ball.position.fromArray(at);
      ball.renderOrder = 3;
      this.marks.add(ball);
      if (!text) continue;
      const sprite = new Sprite(new SpriteMaterial({ transparent: true, sizeAttenuation: false, depthTest: false }));
      sprite.name = text;
      sprite.position.fromArray(at);
      sprite.center.set(0.5, -0.35);
      sprite.renderOrder = 4;
      this.marks.add(sprite);
    }
    this.paint();
  }

  /** The vertex of the cloth that is nearest to where a click hits it. */
  private pick(event: MouseEvent) {
    if (!this.onPick) return;
    const box = this.canvas!.getBoundingClientRect();
    const caster = new Raycaster();
    caster.setFromCamera(new Vector2(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2), this.camera);
    this.cloth.geometry.computeBoundingSphere();
    const hit = caster.intersectObject(this.cloth.mesh)[0];
    if (!hit?.face) return;
    const distance = (v: number) => new Vector3().fromArray(this.cloth.positions, 3 * v).distanceTo(hit.point);
    this.onPick([hit.face.a, hit.face.b, hit.face.c].reduce((a, b) => (distance(b) < distance(a) ? b : a)));
  }

  /** Polylines, one per hand: [n, 3] each. */
  setLines(name: string, polylines: Float32Array[], colour: string, dashed: boolean) {
    if (!this.renderer) return;
    for (const { line } of this.lines.get(name) ?? []) {
      this.scene.remove(line);
      line.geometry.dispose();
      line.material.dispose();
    }
    const made = polylines.filter((points) => points.length >= 6).map((points) => {
      const geometry = new LineGeometry();
      geometry.setPositions(points);
      const material = new LineMaterial({ linewidth: dashed ? 2 : 3, dashed, dashSize: 0.012, gapSize: 0.008, worldUnits: false });
      const line = new Line2(geometry, material);
      if (dashed) line.computeLineDistances();
      line.frustumCulled = false;
      this.scene.add(line);
      return { line, colour };
    });
    this.lines.set(name, made);
    this.paint();
  }
  /** Draws only the first segments of every polyline. */
  limitLines(name: string, segments: number) {
    for (const { line } of this.lines.get(name) ?? []) {
      line.geometry.instanceCount = Math.max(0, segments);
      line.visible = segments > 0;
    }
    this.invalidate();
  }
  showLines(name: string, visible: boolean) {
    for (const { line } of this.lines.get(name) ?? []) line.visible = visible;
    this.invalidate();
  }

  view(which: 'reset' | 'side' | 'top') {
    if (!this.renderer) return;
    this.preset = which;
    const direction = { reset: new Vector3(-0.35, -1.0, 0.72), side: new Vector3(0, -1, 0.06), top: new Vector3(0, -0.001, 1) }[which].normalize();
    const { camera, controls } = this;
    controls.target.set(0, 0, 0);
    for (const seen of this.extent) controls.target.addScaledVector(seen, 1 / this.extent.length);
    let distance = 2;
    // A few steps of centring and scaling put everything into the picture, for any direction and any shape of the
    // picture.
    const point = new Vector3();
    for (let step = 0; step < 12; ++step) {
      camera.position.copy(controls.target).addScaledVector(direction, distance);
      camera.lookAt(controls.target);
      camera.updateMatrixWorld();
      const low = new Vector2(Infinity, Infinity), high = new Vector2(-Infinity, -Infinity);
      for (const seen of this.extent) {
        point.copy(seen).project(camera);
        low.min(point as unknown as Vector2);
        high.max(point as unknown as Vector2);
      }
      const half = Math.tan((camera.fov * Math.PI) / 360) * distance;
      const right = new Vector3().setFromMatrixColumn(camera.matrixWorld, 0), up = new Vector3().setFromMatrixColumn(camera.matrixWorld, 1);
      controls.target.addScaledVector(right, 0.5 * (low.x + high.x) * half * camera.aspect).addScaledVector(up, 0.5 * (low.y + high.y) * half);
      distance *= Math.max(high.x - low.x, high.y - low.y) / 2 / 0.95;
    }
    camera.position.copy(controls.target).addScaledVector(direction, distance);
    this.controls.update();
    this.invalidate();
  }

  /** Draws at the next chance; many calls, one drawing. */
  invalidate() {
    if (this.queued || !this.renderer) return;
    this.queued = true;
    requestAnimationFrame((now) => {
      this.queued = false;
      this.draw();
      this.adapt(now);
    });
  }

  private draw() {
    if (!this.renderer || this.element.clientWidth === 0) return;
    const eye = new Vector3().subVectors(this.camera.position, this.controls.target).normalize();
    for (const surface of [this.cloth, ...Object.values(this.overlays)]) surface.material.uniforms.eye.value = eye;
    this.renderer.render(this.scene, this.camera);
    ++this.drawn;
  }

  /** Fewer pixels where drawing cannot keep up with 30 frames per second. */
  private adapt(now: number) {
    const passed = now - this.lastDraw;
    this.lastDraw = now;
    if (passed > 250) return;
    this.slow = passed > 36 ? this.slow + 1 : Math.max(0, this.slow - 1);
    if (this.slow > 12 && this.ratio > 0.6) {
      this.ratio = Math.max(0.6, this.ratio * 0.8);
      this.slow = 0;
      this.resize();
    }
  }

  private resize() {
    if (!this.renderer) return;
    const { clientWidth: width, clientHeight: height } = this.element;
    if (width === 0 || height === 0) return;
    const reframe = this.camera.aspect !== width / height;
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    for (const made of this.lines.values()) for (const { line } of made) line.material.resolution.set(width, height);
    if (reframe && this.preset) this.view(this.preset);
    this.invalidate();
  }

  private paint() {
    if (!this.renderer) return;
    this.renderer.setClearColor(new Color(cssColour('view')));
    this.cloth.paint();
    for (const overlay of Object.values(this.overlays)) overlay.paint();
    this.cloth.material.uniforms.map.value ??= mapTexture();
    (this.shadow.material as MeshBasicMaterial).color.set(cssColour('shadow'));
    (this.edges.material as LineBasicMaterial).color.set(cssColour('edge'));
    for (const made of this.lines.values()) {
      for (const { line, colour } of made) {
        line.material.color.set(cssColour(colour));
        line.material.resolution.set(this.element.clientWidth, this.element.clientHeight);
      }
    }
    for (const hand of this.hands) (hand.material as MeshBasicMaterial).color.set(cssColour('executed'));
    for (const object of this.marks.children) {
      if (object instanceof Mesh) (object.material as MeshBasicMaterial).color.set(cssColour('executed'));
      else if (object instanceof Sprite) labelSprite(object, object.name, 'ink');
    }
    for (const object of this.ground.children) {
      if (object instanceof LineSegments) (object.material as LineBasicMaterial).color.set(cssColour(object.name));
      else if (object instanceof Sprite) labelSprite(object, object.name);
    }
    this.invalidate();
  }

  /** Lines every 10 cm, stronger every 50 cm, with the distances from the corner written along two sides. */
  private makeGround(low: Vector3, high: Vector3) {
    const cell = 0.1, pad = 0.02;
    const x0 = Math.floor((low.x - pad) / cell), x1 = Math.ceil((high.x + pad) / cell);
    const y0 = Math.floor((low.y - pad) / cell), y1 = Math.ceil((high.y + pad) / cell);
    // With room for the numbers along the near and the left side.
    for (const y of [y0 * cell - 0.05, y1 * cell]) for (const x of [x0 * cell - 0.08, x1 * cell + 0.04]) this.extent.push(new Vector3(x, y, 0));
    const key = [x0, x1, y0, y1].join();
    if (key === this.groundKey) return;
    this.groundKey = key;
    this.ground.clear();
    const thin: number[] = [], strong: number[] = [];
    const add = (step: number, origin: number, ...ends: number[]) => ((step - origin) % 5 === 0 ? strong : thin).push(...ends);
    for (let i = x0; i <= x1; ++i) add(i, x0, i * cell, y0 * cell, 0, i * cell, y1 * cell, 0);
    for (let i = y0; i <= y1; ++i) add(i, y0, x0 * cell, i * cell, 0, x1 * cell, i * cell, 0);
    for (const [name, points] of [['grid', thin], ['grid-strong', strong]] as const) {
      const geometry = new BufferGeometry().setAttribute('position', new BufferAttribute(new Float32Array(points), 3));
      const lines = new LineSegments(geometry, new LineBasicMaterial(kOnTheGround));
      lines.name = name;
      lines.renderOrder = -2;
      this.ground.add(lines);
    }
    const write = (text: string, x: number, y: number) => {
      const sprite = new Sprite(new SpriteMaterial({ transparent: true, sizeAttenuation: false, ...kOnTheGround }));
      sprite.name = text;
      sprite.position.set(x, y, 0);
      this.ground.add(sprite);
    };
    for (let i = x0; i <= x1; i += 2) write(`${(i - x0) * 10}${i + 2 > x1 ? ' cm' : ''}`, i * cell, y0 * cell - 0.05);
    for (let i = y0 + 2; i <= y1; i += 2) write(`${(i - y0) * 10}`, x0 * cell - 0.06, i * cell);
  }

  private key(event: KeyboardEvent) {
    const step = 0.08;
    const orbit = (azimuth: number, polar: number) => {
      const offset = new Spherical();
      const toY = new Vector3().subVectors(this.camera.position, this.controls.target);
      offset.setFromCartesianCoords(toY.x, toY.z, -toY.y);
      offset.theta += azimuth;
      offset.phi = Math.min(Math.max(offset.phi + polar, 0.001), this.controls.maxPolarAngle);
      const p = new Vector3().setFromSpherical(offset);
      this.camera.position.copy(this.controls.target).add(new Vector3(p.x, -p.z, p.y));
    };
    const pan = (right: number, up: number) => {
      const x = new Vector3().setFromMatrixColumn(this.camera.matrix, 0);
      const y = new Vector3().crossVectors(this.camera.up, x);
      const move = x.multiplyScalar(right * 0.04).addScaledVector(y, up * 0.04);
      this.camera.position.add(move);
      this.controls.target.add(move);
    };
    const zoom = (factor: number) => this.camera.position.sub(this.controls.target).multiplyScalar(factor).add(this.controls.target);
    const turn = event.shiftKey ? pan : null;
    const actions: Record<string, () => void> = {
      ArrowLeft: () => (turn ? turn(-1, 0) : orbit(-step, 0)), ArrowRight: () => (turn ? turn(1, 0) : orbit(step, 0)),
      ArrowUp: () => (turn ? turn(0, 1) : orbit(0, -step)), ArrowDown: () => (turn ? turn(0, -1) : orbit(0, step)),
      '+': () => zoom(0.9), '=': () => zoom(0.9), '-': () => zoom(1 / 0.9), _: () => zoom(1 / 0.9),
      r: () => this.view('reset'), 1: () => this.view('reset'), 2: () => this.view('side'), 3: () => this.view('top'),
    };
    const action = event.ctrlKey || event.metaKey || event.altKey ? undefined : actions[event.key] ?? actions[event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    event.stopPropagation();
    if (!/^[r123]$/i.test(event.key)) this.preset = null;
    action();
    this.controls.update();
    this.invalidate();
  }

  private save() {
    this.draw();  // a drawing buffer is only readable in the turn that filled it
    this.canvas!.toBlob((blob) => {
      const link = h('a', { href: URL.createObjectURL(blob!), download: 'weft.png' });
      link.click();
      setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    });
  }
}

/**
 * How WebGL draws, or null without WebGL. (Tested here, because three.js would report it on the console.) Software
 * renderers cannot afford several samples per pixel.
 */
function webGl(): { software: boolean } | null {
  try {
    const context = document.createElement('canvas').getContext('webgl2');
    if (!context) return null;
    const info = context.getExtension('WEBGL_debug_renderer_info');
    const name = String(context.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : context.RENDERER));
    context.getExtension('WEBGL_lose_context')?.loseContext();
    return { software: /swiftshader|llvmpipe|softpipe|basic render/i.test(name) };
  } catch {
    return null;
  }
}

function edgeGeometry(faces: Uint32Array, shared: BufferGeometry): BufferGeometry {
  const seen = new Set<string>();
  const pairs: number[] = [];
  for (let f = 0; f < faces.length; f += 3) {
    for (let k = 0; k < 3; ++k) {
      const a = faces[f + k], b = faces[f + ((k + 1) % 3)];
      const key = a < b ? `${a} ${b}` : `${b} ${a}`;
      if (!seen.has(key)) pairs.push(a, b);
      seen.add(key);
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute('position', shared.attributes.position);
  geometry.setIndex(pairs);
  return geometry;
}

function mapTexture(): DataTexture {
  const texture = new DataTexture(colourMap(), 256, 1, RGBAFormat);
  texture.needsUpdate = true;
  return texture;
}

function labelSprite(sprite: Sprite, text: string, colour = 'muted') {
  const canvas = document.createElement('canvas'), font = '34px system-ui, sans-serif';
  const measure = canvas.getContext('2d')!;
  measure.font = font;
  canvas.width = Math.max(128, Math.ceil(measure.measureText(text).width / 2) * 2 + 16);
  canvas.height = 64;
  const context = canvas.getContext('2d')!;
  context.font = font;
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  context.fillStyle = cssColour(colour);
  context.fillText(text, canvas.width / 2, 32);
  sprite.material.map?.dispose();
  sprite.material.map = new CanvasTexture(canvas);
  sprite.material.map.colorSpace = 'srgb';
  sprite.material.needsUpdate = true;
  sprite.scale.set((kLabelHeight * canvas.width) / canvas.height, kLabelHeight, 1);
}
