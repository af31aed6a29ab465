// The data of a page, as framework/report/page.cpp puts it there; docs/report.md describes it.
import { unzlibSync } from 'fflate';

export interface ArrayRef {
  array: number;
  type: 'i16' | 'i32' | 'f32';
  shape: number[];
  step: number;
}
export interface Knowledge { centre: number[]; width: number[] }
export interface Variable { name: string; unit: string }
export interface Garment { name: string; vertices: number; faces: ArrayRef; held?: number[]; held_until?: number[] }
export interface Provenance {
  weft?: string; commit?: string; seed?: number; threads?: number;
  plugins?: { kind: string; name: string; version: string }[];
}

export interface Round {
  controls: number[][];
  state: number[];
  knowledge: Knowledge;
  error_mm: number;
  prediction: { error_mm: number[]; sigma_mm: number[]; coverage_1sigma: number[] };
  losses: number[];
  curves: ArrayRef;
  mean: ArrayRef;
  sigma: ArrayRef;
  targets: ArrayRef;
}
/** Why a search ended: of the instance that won, and how many instances ended how. */
export interface SearchEnd { status: string; message: string; instances: Record<string, number> }
/** A correction of the plan by simulations (docs/file-formats.md). */
export interface Correction {
  started: number;
  in_force: number;
  dropped: boolean;
  /** null here and in simulations: the simulation diverged, or there was none. */
  forecast_mm: number | null;
  corrected_mm: number | null;
  simulations: { release: number; found: string; error_mm: number | null; best: boolean }[];
}
export interface Summary {
  /** null: the goal's points are not the garment's; there is chamfer_mm then. */
  error_mm: number | null;
  default_error_mm: number | null;
  chamfer_mm?: number; default_chamfer_mm?: number;
  /** Missing in sessions of earlier versions, as all keys of this line and the next. null: no such vertex was seen. */
  max_error_mm?: number | null; grasped_error_mm?: number | null; named_error_mm?: number | null;
  silhouette_iou?: number | null; success_10mm?: boolean; success_20mm?: boolean; success_30mm?: boolean;
  /** null: the task's. */
  world?: { spread: number; simulator: string } | null;
  segments: number;
  settled?: boolean;
  settle_frames: number;
  plan_seconds: number[];
  plan_iterations: number[];
  /** Missing in sessions of earlier versions. */
  plan_ended?: SearchEnd[];
  predicted_error_mm: number[];
  estimate_seconds: number[];
  simulate_seconds?: number;
  /** Where plans were corrected by simulations. */
  corrections?: Correction[];
  correction_seconds?: number[];
  max_grasp_strain?: number | null;
  warnings: string[];
}
export interface SessionData {
  frames_per_segment: number;
  frame_seconds: number;
  released: boolean;
  /** Frame at which the hands let go; what follows is the settling. */
  release_frame: number;
  /** Missing if unknown. */
  true_material?: number[];
  start_error_mm: number;
  frames: ArrayRef;
  goal: ArrayRef;
  /** Of a goal whose points are not the garment's. Distances to such a goal are chamfer distances. */
  goal_faces?: ArrayRef;
  default_shape: ArrayRef;
  rounds: Round[];
  /** After 0, 1, 2, ... segments, where the material was estimated. */
  estimates?: Knowledge[];
}

export interface Spread { mean: number; sd: number; median: number }
export interface PlanningCase { width: number; goal: number; error_mm: number | null; plan_seconds?: number; failed?: string }
export interface PlanningWidth {
  width: number; n: number; mean_mm: number; median_mm: number; sd_mm: number; q1_mm: number; q3_mm: number;
  outliers: number;
  /** Missing in files of earlier versions, as the shares of successes. */
  silhouette_iou?: number | null; success_10mm?: number | null; success_20mm?: number | null; success_30mm?: number | null;
}
/** Rows that belong to another config, file, plugin or version than the others of their table. */
export interface Mixed { identity: string; seeds: number[]; changes: string[] }
export interface PlanningData {
  mixed?: Mixed[];
  goals?: string; complete?: boolean; cases: PlanningCase[]; by_width: PlanningWidth[];
  /** The same for further sources of goals. */
  columns?: Record<string, { by_width: PlanningWidth[] }>;
}
export interface PropertyResult {
  abs_error: Spread; width: Spread; /** null: no case was finished. */
  failure_rate: number | null; coverage: Record<string, number>; interval_score: number;
}
export interface EstimationCase { seed?: number; true_material: number[]; knowledge: Knowledge[] }
export interface EstimationFigures { n: number; properties: Record<string, PropertyResult> }
export interface EstimationData {
  mixed?: Mixed[];
  goals?: string; method?: string; n?: number; complete?: boolean; properties: Record<string, PropertyResult>;
  cases: (EstimationCase | { failed: string })[];
  /** Figures of every source and method. */
  columns?: Record<string, Record<string, EstimationFigures>>;
}
export interface StepResult {
  steps: number; n?: number; mean_mm: number; median_mm: number; nll: number; coverage_1sigma: number; nse: number; sigma_mm?: number;
}
export interface PredictionData {
  settled?: Record<string, Omit<StepResult, 'steps'>>;
  by_step: StepResult[];
  by_step_from_random?: StepResult[];
  by_step_no_knowledge?: StepResult[];
  baselines?: Record<string, { n: number; mean_mm: number; median_mm: number }>;
  /** Released examples, predicted from their start; the first of them have shapes. */
  cases?: { example: number; segments: number; error_mm: number; sigma_mm: number }[];
}
export interface Statistics {
  n: number; mean: number | null; median: number | null; sd: number | null;
  mean_95: [number | null, number | null]; median_95: [number | null, number | null];
}
/** Of the medians over the seeds that an arm, its baseline and its target completed. */
export interface Medians {
  n: number; baseline_over_own: number | null; baseline_over_own_95: [number | null, number | null];
  gap_closed?: number | null; gap_closed_95?: [number | null, number | null];
}
export interface Arm {
  name: string;
  levels: Record<string, string>;
  done: number;
  failed: { seed: number; failure: string }[];
  baseline: string | null;
  mixed?: Mixed[];
  metrics: Record<string, Statistics & { difference?: Statistics; medians?: Medians }>;
}
export interface PhysicsRow {
  test: string; case: string; variant: string; quantity: string; reference: number; measured: number | null;
  /** null: the case threw. */
  error: number | null;
  bound: number; passed: boolean; note: string;
  /** Of random folds: seed, value. */
  by_seed?: [number, number][];
}
export interface PhysicsData { comparisons: number; failed: number; rows: PhysicsRow[] }
export interface AblationData { description: string; factors: string[]; seeds: number[]; /** Names of the cases, if the seeds count cases. */ cases?: string[]; /** Arms close a share of a gap. */ has_target?: boolean; complete: boolean; arms: Arm[] }

export type FindingKind = 'fact' | 'mended' | 'warning' | 'limit';
export interface Finding { pass: string; kind: FindingKind; count: number; text: string; places?: { element: string; at: number[] }[] }
export interface GarmentMesh {
  /** As the garment's YAML names it. */
  file: string;
  positions: ArrayRef;
  named: Record<string, number>;
  /** The garment's YAML but for its vertices. */
  head: string;
  /** Of an import: the triangles of the file, and what was found and done. */
  before?: { vertices: number; faces: ArrayRef; positions: ArrayRef };
  findings?: Finding[];
}

export interface CaseShapes {
  /** Final shapes, as differences from their goals ... */
  goals?: ArrayRef[]; offsets?: ArrayRef[]; goal_of?: number[];
  /** ... or shapes after 0, 1, 2, ... segments; null where none were recorded. */
  sequences?: (ArrayRef | null)[];
}
export interface PageData {
  schema: string;
  kind: 'session' | 'evaluation' | 'ablation' | 'garment';
  properties: string[];
  provenance?: Provenance;
  config?: string;
  summary?: Summary;
  garment?: Garment;
  trajectory?: { controls: Variable[]; state: Variable[] };
  session?: SessionData;
  mesh?: GarmentMesh;
  planning?: PlanningData;
  estimation?: EstimationData;
  prediction?: PredictionData;
  physics?: PhysicsData;
  ablation?: AblationData;
  shapes?: Record<string, CaseShapes>;
}

export function readPage(): PageData | null {
  const element = document.getElementById('weft-data');
  return element ? (JSON.parse(element.textContent!) as PageData) : null;
}

function bytesOf(base64: string): Uint8Array {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; ++i) bytes[i] = text.charCodeAt(i);
  return bytes;
}

const product = (shape: number[]) => shape.reduce((a, b) => a * b, 1);

/** The inverse of PageData::store and append_difference in page.cpp. */
export function decode(ref: ArrayRef): Float32Array {
  const element = document.getElementById(`weft-array-${ref.array}`);
  const bytes = unzlibSync(bytesOf(element!.textContent!));
  const count = product(ref.shape);
  const size = ref.type === 'i16' ? 2 : 4;
  const words = new Uint8Array(count * size);
  for (let byte = 0; byte < size; ++byte) {
    for (let i = 0, from = byte * count; i < count; ++i) words[i * size + byte] = bytes[from + i];
  }
  if (ref.type === 'f32') return new Float32Array(words.buffer);
  const values = ref.type === 'i16' ? new Int16Array(words.buffer) : new Int32Array(words.buffer);
  const row = product(ref.shape.slice(1));
  for (let i = row; i < count; ++i) values[i] += values[i - row];
  const result = new Float32Array(count);
  for (let i = 0; i < count; ++i) result[i] = values[i] * ref.step;
  return result;
}

export function decodeFaces(ref: ArrayRef): Uint32Array {
  return Uint32Array.from(decode(ref));
}

/** Shapes [n, V, 3], decoded on first use. */
export class Shapes {
  private values: Float32Array | null = null;
  readonly count: number;
  readonly size: number;
  constructor(private readonly ref: ArrayRef) {
    this.count = ref.shape[0];
    this.size = product(ref.shape.slice(1));
  }
  at(i: number): Float32Array {
    this.values ??= decode(this.ref);
    return this.values.subarray(i * this.size, (i + 1) * this.size);
  }
}

/** Distance of every vertex in mm. */
export function distancesMm(a: Float32Array, b: Float32Array, out = new Float32Array(a.length / 3)): Float32Array {
  for (let v = 0, i = 0; v < out.length; ++v, i += 3) {
    out[v] = 1000 * Math.hypot(a[i] - b[i], a[i + 1] - b[i + 1], a[i + 2] - b[i + 2]);
  }
  return out;
}

export const mean = (values: ArrayLike<number>) => {
  let sum = 0;
  for (let i = 0; i < values.length; ++i) sum += values[i];
  return values.length ? sum / values.length : NaN;
};
export const quantile = (values: number[], q: number) => {
  const sorted = [...values].sort((a, b) => a - b);
  if (sorted.length === 0) return NaN;
  const at = q * (sorted.length - 1), low = Math.floor(at);
  return sorted[low] + (at - low) * ((sorted[low + 1] ?? sorted[low]) - sorted[low]);
};
