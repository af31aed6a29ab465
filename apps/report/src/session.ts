// The page of one session.
import { chart, key, materialChart, Plot, wholeTicks, type Chart } from './charts';
import { colourLegend, niceCeiling } from './colours';
import { decode, decodeFaces, distancesMm, quantile, Shapes, type PageData, type SearchEnd, type Summary } from './data';
import { duration, fixed, h, hashOptions, label, section } from './dom';
import { provenanceDetails, tile, title } from './frame';
import { Player, seconds } from './player';
import { Viewer } from './viewer';

type Colouring = 'fabric' | 'goal' | 'prediction' | 'sigma';
const kColourings: Record<Colouring, { option: string; legend: string }> = {
  fabric: { option: 'fabric, front and back', legend: '' },
  goal: { option: 'distance to the goal', legend: 'distance to the goal, mm' },
  prediction: { option: 'distance from the prediction', legend: 'distance from the prediction, mm' },
  sigma: { option: 'predicted sigma', legend: 'predicted σ, mm' },
};

/** As in "It converged (every step is below step_tolerance); all instances: converged 12, budget spent 4". */
function howItEnded(end: SearchEnd): string {
  const words: Record<string, string> = { budget_spent: 'ran out of budget', stopped: 'was stopped', diverged: 'found no finite loss', infeasible: 'could not be solved' };
  const one = words[end.status] ?? end.status;
  const all = Object.entries(end.instances).map(([status, number]) => `${status.replaceAll('_', ' ')} ${number}`).join(', ');
  return `It ${one}${end.message ? ` (${end.message})` : ''}; all instances: ${all}`;
}

export function sessionPage(page: PageData): HTMLElement {
  const session = page.session!, summary = page.summary!, garment = page.garment!;
  const { rounds } = session;
  const perSegment = session.frames_per_segment;
  const frames = new Shapes(session.frames);
  const goal = new Shapes(session.goal).at(0);
  const defaultShape = new Shapes(session.default_shape);
  const means = rounds.map((round) => new Shapes(round.mean));
  const sigmas = rounds.map((round) => new Shapes(round.sigma));
  const hands = garment.held?.length ?? 0;
  const corresponds = !session.goal_faces;
  const endError = summary.error_mm ?? summary.chamfer_mm ?? 0, defaultError = summary.default_error_mm ?? summary.default_chamfer_mm ?? 0;
  const last = frames.count - 1, release = session.release_frame;

  const held = garment.held ?? [];
  /** The last frame in which each hand holds the cloth. */
  const heldUntil = garment.held_until ?? held.map(() => release);

  /** The segment a frame belongs to, counted from 1; 0 at the start. */
  const segmentOf = (frame: number) => Math.min(Math.ceil(frame / perSegment - 1e-9), rounds.length);
  /** The frame at which a segment has ended; the last one settled. */
  const frameAfter = (segment: number) => (segment >= rounds.length ? last : segment * perSegment);
  /** What the cloth was after a segment. */
  const after = (segment: number) => frames.at(frameAfter(segment));
  const describe = (frame: number) => {
    if (frame > release) return `${frame < last ? 'released, settling' : summary.settled === false ? 'end, still moving' : 'settled'} · ${seconds(frame, session.frame_seconds)}, ${seconds(frame - release, session.frame_seconds)} after release`;
    const open = heldUntil.filter((until) => frame > until).length;
    return `frame ${frame} · segment ${segmentOf(frame)} of ${rounds.length} · ${seconds(frame, session.frame_seconds)}${open > 0 ? ` · ${open} of ${hands} hands open` : ''}`;
  };

  // What is chosen.
  const options = hashOptions();
  let round = 0;
  let follow = false;
  let colouring: Colouring = 'fabric';

  const viewer = new Viewer(decodeFaces(garment.faces), garment.vertices, `${garment.name} being folded`,
    session.goal_faces && { faces: decodeFaces(session.goal_faces), vertices: goal.length / 3 });

  // Side panel.
  const check = (id: string, text: string, checked: boolean, swatch: HTMLElement | null = null) => {
    const input = h('input', { type: 'checkbox', id, checked });
    input.addEventListener('change', () => update());
    return { input, element: h('label', { class: 'check' }, input, swatch, text) };
  };
  const box = (colour: string) => h('span', { class: 'swatch', style: `background:var(--${colour})` });
  const line = (colour: string, dashed = false) => h('span', { class: `swatch line${dashed ? ' dashed' : ''}`, style: `width:1.3rem;border-color:var(--${colour})` });
  const layers = {
    goal: check('show-goal', 'goal', true, box('goal')),
    prediction: check('show-prediction', 'prediction of the round', false, box('prediction')),
    edges: check('show-edges', 'mesh edges', false),
    executed: check('show-executed', 'path of the hands', true, line('executed')),
    planned: check('show-planned', 'planned path of the round', true, line('planned', true)),
    fallback: check('show-default', 'result of the default control instead', false),
  };
  const hasSigma = rounds.some((r) => r.sigma.shape[0] > 0);
  const colourSelect = h('select', { id: 'colouring' },
    ...(Object.keys(kColourings) as Colouring[]).filter((name) => (name !== 'sigma' || hasSigma) && (name !== 'goal' || corresponds)).map((name) => h('option', { value: name }, kColourings[name].option)));
  colourSelect.addEventListener('change', () => {
    colouring = colourSelect.value as Colouring;
    update();
  });
  const roundSelect = h('select', { id: 'round' }, ...rounds.map((r, i) => h('option', { value: i }, `${i + 1}: ${r.controls.length} segment${r.controls.length === 1 ? '' : 's'} to go`)));
  roundSelect.addEventListener('change', () => chooseRound(Number(roundSelect.value), true));
  const followBox = check('follow', 'follow the playback', follow);
  followBox.input.addEventListener('change', () => {
    follow = followBox.input.checked;
    showFrame(player.frame);
  });
  const facts = h('dl', { class: 'facts', id: 'facts' });
  const legend = h('div', { class: 'legend', hidden: true });
  viewer.element.append(legend);
  const panel = h('div', { class: 'panel' },
    h('fieldset', {}, h('legend', {}, 'Shown with the cloth'), layers.goal.element, layers.prediction.element, layers.executed.element, layers.planned.element, layers.edges.element, layers.fallback.element),
    h('label', { class: 'field' }, 'Colour of the cloth', colourSelect),
    h('div', {}, h('label', { class: 'field' }, 'Planning round', roundSelect), followBox.element),
    facts);

  // Scales of the colours are fixed over the session, so that frames can be compared.
  const range: Record<Colouring, number> = {
    fabric: 1,
    goal: corresponds ? niceCeiling(Math.max(10, 0.5 * defaultError, quantile([...distancesMm(frames.at(last), goal)], 0.98))) : 1,
    prediction: niceCeiling(Math.max(1, 2.5 * Math.max(...rounds.flatMap((r) => r.prediction.error_mm), 0))),
    sigma: niceCeiling(Math.max(1, 1.5 * Math.max(...rounds.flatMap((r) => r.prediction.sigma_mm), 0))),
  };

  // Paths of the hands.
  const executedPaths = held.map((vertex, hand) => {
    const points = new Float32Array(3 * frames.count);
    for (let f = 0; f < frames.count; ++f) points.set(frames.at(f).subarray(3 * vertex, 3 * vertex + 3), 3 * f);
    return points.subarray(0, 3 * (heldUntil[hand] + 1));
  });
  const planned = new Map<number, Float32Array[]>();
  const plannedPaths = (r: number) => {
    if (!planned.has(r)) {
      const targets = decode(rounds[r].targets);
      const count = rounds[r].targets.shape[0];
      const start = frames.at(r * perSegment);
      planned.set(r, count === 0 ? [] : held.flatMap((vertex, hand) => {
        if (heldUntil[hand] <= r * perSegment) return [];  // it opened before
        const points = new Float32Array(3 * (count + 1));
        points.set(start.subarray(3 * vertex, 3 * vertex + 3));
        for (let i = 0; i < count; ++i) points.set(targets.subarray(3 * (i * hands + hand), 3 * (i * hands + hand) + 3), 3 * (i + 1));
        return [points];
      }));
    }
    return planned.get(r)!;
  };

  const current = new Float32Array(garment.vertices * 3);
  const values = new Float32Array(garment.vertices);
  let predictionKey = '';

  /** Draws a moment of the session; between frames the shape is interpolated. */
  function showFrame(position: number) {
    const frame = Math.floor(position), part = position - frame;
    if (layers.fallback.input.checked) current.set(defaultShape.at(0));
    else {
      const a = frames.at(frame);
      if (part > 0 && frame < last) {
        const b = frames.at(frame + 1);
        for (let i = 0; i < current.length; ++i) current[i] = a[i] + part * (b[i] - a[i]);
      } else current.set(a);
    }
    viewer.setCloth(current);

    const segment = segmentOf(Math.round(position));
    if (follow && rounds.length > 0) chooseRound(Math.max(0, segment - 1), false);
    const step = segment - round - 1;  // which of the round's predicted shapes belongs to this segment
    const predicted = rounds.length > 0 && step >= 0 && step < means[round].count;
    const wanted = `${round} ${predicted ? step : ''} ${segment} ${layers.prediction.input.checked}`;
    if (wanted !== predictionKey) {
      predictionKey = wanted;
      viewer.setOverlay('prediction', predicted && layers.prediction.input.checked ? means[round].at(step) : null);
      showFacts(segment, predicted ? step : null);
    }
    if (colouring === 'goal') viewer.setColours(distancesMm(current, goal, values), range.goal);
    else if (colouring === 'prediction' && predicted) viewer.setColours(distancesMm(after(segment), means[round].at(step), values), range.prediction);
    else if (colouring === 'sigma' && predicted && step < sigmas[round].count) {
      viewer.setColours(distancesMm(sigmas[round].at(step), new Float32Array(current.length), values), range.sigma);
    } else viewer.setColours(null, 1);

    const closed = held.filter((_, hand) => position <= heldUntil[hand]);
    const points = new Float32Array(3 * closed.length);
    closed.forEach((vertex, i) => points.set(current.subarray(3 * vertex, 3 * vertex + 3), 3 * i));
    viewer.setHands(layers.executed.input.checked && closed.length > 0 && !layers.fallback.input.checked ? points : null);
    viewer.limitLines('executed', layers.executed.input.checked ? Math.round(position) : 0);
    for (const one of timeCharts) one.mark(Math.min(position / perSegment, rounds.length));
    for (const one of knowledgeCharts) one.mark(Math.min(position / perSegment, known.length - 1));
  }

  function chooseRound(next: number, byHand: boolean) {
    if (byHand) {
      follow = false;
      followBox.input.checked = false;
    }
    if (next === round && roundSelect.value === String(next) && !byHand) return;
    round = next;
    roundSelect.value = String(next);
    viewer.setLines('planned', plannedPaths(round), 'planned', true);
    viewer.showLines('planned', layers.planned.input.checked);
    predictionKey = '';
    for (const one of roundCharts) one.redraw();
    lossNote();
    if (byHand) showFrame(player.frame);
  }

  function showFacts(segment: number, step: number | null) {
    const error = segment === 0 ? session.start_error_mm : rounds[segment - 1].error_mm;
    const rows: [string, string, string][] = [
      [segment === 0 ? 'Distance to the goal at the start' : `Distance to the goal after segment ${segment}`, fixed(error), 'segment-error'],
    ];
    const of = rounds[round]?.prediction;
    if (step !== null && of) {
      if (step < of.error_mm.length) rows.push([`Predicted ${step + 1} ahead, off by`, fixed(of.error_mm[step]), 'prediction-error']);
      if (step < of.sigma_mm.length) rows.push(['Predicted σ, mean', fixed(of.sigma_mm[step]), 'prediction-sigma']);
      if (step < of.coverage_1sigma.length) rows.push(['Coordinates within 1 σ', `${fixed(100 * of.coverage_1sigma[step], 0)} %`, 'prediction-coverage']);
    }
    facts.replaceChildren(...rows.flatMap(([name, value, id]) => [
      h('dt', {}, name), h('dd', { 'data-key': id }, value.endsWith('%') ? value : `${value} mm`)]));
  }

  function update() {
    viewer.setOverlay('goal', layers.goal.input.checked ? goal : null);
    viewer.setEdges(layers.edges.input.checked);
    viewer.showLines('planned', layers.planned.input.checked);
    legend.hidden = colouring === 'fabric';
    if (colouring !== 'fabric') legend.replaceChildren(...colourLegend(kColourings[colouring].legend, range[colouring]));
    predictionKey = '';
    showFrame(player.frame);
  }

  // Figures.
  const seek = (segment: number) => {
    player.pause();
    player.seek(frameAfter(Math.round(segment)));
  };
  const errors = [{ segment: 0, error: session.start_error_mm }, ...rounds.map((r, i) => ({ segment: i + 1, error: r.error_mm }))];
  const plannedErrors = summary.predicted_error_mm.map((error, i) => ({ segment: i, error }));
  const highest = Math.max(defaultError, ...plannedErrors.map((p) => p.error), 1);
  const errorChart = chart('Distance to the goal over segments', (width) => ({
    x: { domain: [0, Math.max(1, rounds.length)], ticks: wholeTicks(0, rounds.length, width), tickFormat: 'd', label: 'segments executed' },
    y: { domain: [0, 1.1 * Math.max(highest, session.start_error_mm)], label: 'mm', grid: true, nice: true },
    marks: [
      Plot.ruleY([defaultError], { stroke: 'var(--muted)', strokeDasharray: '6,4', strokeWidth: 1.5 }),
      Plot.lineY(errors, { x: 'segment', y: 'error', stroke: 'var(--c0)', strokeWidth: 2.2 }),
      Plot.dot(errors, { x: 'segment', y: 'error', fill: 'var(--c0)', r: 2.6, tip: true, title: (d) => `after segment ${d.segment}: ${fixed(d.error)} mm` }),
      Plot.lineY(plannedErrors, { x: 'segment', y: 'error', stroke: 'var(--c1)', strokeWidth: 2 }),
      Plot.dot(plannedErrors, { x: 'segment', y: 'error', fill: 'var(--c1)', symbol: 'square', r: 2.4 }),
    ],
  }), { seek });

  // After each segment where it was estimated, else what each plan was made with.
  const known = session.estimates ?? rounds.map((r) => r.knowledge);
  const knowledgeCharts = page.properties.map((name, p) => materialChart(name, known, p, session.true_material?.[p], { seek }));

  const winner = () => rounds[round].losses.indexOf(Math.min(...rounds[round].losses));
  const lossChart = chart('Planning loss per iteration and instance', (width) => {
    const { curves, losses } = rounds[round];
    const [iterations, instances] = curves.shape;
    const table = decode(curves);
    const best = winner();
    const rows: { iteration: number; loss: number; instance: number }[] = [];
    for (let k = 0; k < iterations; ++k) {
      for (let i = 0; i < instances; ++i) {
        if (Number.isFinite(table[k * instances + i])) rows.push({ iteration: k + 1, loss: table[k * instances + i], instance: i });
      }
    }
    return {
      x: { ticks: wholeTicks(0, iterations, width), tickFormat: 'd', label: 'iteration', domain: [0, Math.max(1, iterations)] },
      y: { type: 'log', label: 'loss, mm²', grid: true, nice: true, tickFormat: '~s', ticks: 5 },
      marks: [
        Plot.lineY(rows.filter((row) => row.instance !== best), { x: 'iteration', y: 'loss', z: 'instance', stroke: 'var(--muted)', strokeOpacity: 0.55 }),
        Plot.lineY(rows.filter((row) => row.instance === best), { x: 'iteration', y: 'loss', stroke: 'var(--c1)', strokeWidth: 2.4 }),
        ...(rows.length ? [] : [Plot.text([`${losses.length} instances; curves were not recorded`], { frameAnchor: 'middle' })]),
      ],
    };
  });
  const lossText = h('p', { class: 'note', id: 'loss-note' });
  function lossNote() {
    if (rounds.length === 0) return;
    if (corrections.length > 0 && summary.plan_iterations[round] === 0) {
      const made = corrections.find((one) => one.in_force === round && !one.dropped);
      lossText.textContent = made ? `Round ${round + 1}: a corrected plan, the best of ${made.simulations.length} that were simulated; its loss is ${fixed(Math.min(...rounds[round].losses), 2)} mm².` : `Round ${round + 1}: the plan in force stays.`;
      return;
    }
    const won = `Round ${round + 1}: ${summary.plan_iterations[round]} iterations of ${rounds[round].losses.length} instances in ${duration(summary.plan_seconds[round])}; instance ${winner() + 1} won with ${fixed(Math.min(...rounds[round].losses))} mm²`;
    const ended = summary.plan_ended?.[round];
    lossText.textContent = `${won}${ended ? `. ${howItEnded(ended)}` : ''}.`;
  }

  const aheadChart = chart('Prediction of the round against the execution', (width) => {
    const { error_mm, sigma_mm } = rounds[round].prediction;
    const rows = error_mm.map((error, j) => ({ segment: round + j + 1, value: error }));
    const spread = sigma_mm.map((value, j) => ({ segment: round + j + 1, value }));
    const top = Math.max(1, ...rounds.flatMap((r) => [...r.prediction.error_mm, ...r.prediction.sigma_mm]));
    const others = rounds.flatMap((r, i) => r.prediction.error_mm.map((value, j) => ({ round: i, segment: i + j + 1, value })));
    return {
      x: { domain: [0, Math.max(1, rounds.length)], ticks: wholeTicks(0, rounds.length, width), tickFormat: 'd', label: 'segments executed' },
      y: { domain: [0, top], nice: true, label: 'mm', grid: true },
      marks: [
        Plot.lineY(others, { x: 'segment', y: 'value', z: 'round', stroke: 'var(--muted)', strokeOpacity: 0.35, strokeWidth: 1 }),
        Plot.areaY(spread.filter((row) => row.segment <= rounds.length), { x: 'segment', y1: 0, y2: 'value', fill: 'var(--prediction)', fillOpacity: 0.2 }),
        Plot.lineY(spread.filter((row) => row.segment <= rounds.length), { x: 'segment', y: 'value', stroke: 'var(--prediction)', strokeOpacity: 0.7, marker: spread.length === 1 ? 'dot' : undefined }),
        Plot.lineY(rows, { x: 'segment', y: 'value', stroke: 'var(--c0)', strokeWidth: 2.2 }),
        Plot.dot(rows, { x: 'segment', y: 'value', fill: 'var(--c0)', r: 2.6, tip: true, title: (d) => `segment ${d.segment}: off by ${fixed(d.value)} mm` }),
      ],
    };
  }, { seek });

  const times = rounds.flatMap((_, i) => [
    { round: i + 1, phase: 'plan', seconds: summary.plan_seconds[i] ?? 0 },
    { round: i + 1, phase: 'estimate', seconds: summary.estimate_seconds[i] ?? 0 },
  ]);
  const total = (list: number[]) => list.reduce((a, b) => a + b, 0);
  const estimated = summary.estimate_seconds.length > 0;
  const timeChart = chart('Time per round', (width) => ({
    x: { type: 'band', domain: rounds.map((_, i) => i + 1), ticks: wholeTicks(1, rounds.length, width), tickFormat: 'd', label: 'round', padding: 0.15 },
    y: { label: 's', grid: true, nice: true },
    marks: [
      Plot.barY(times, { x: 'round', y: 'seconds', fill: (d) => (d.phase === 'plan' ? 'var(--c1)' : 'var(--c2)'), tip: true, title: (d) => `${d.phase}, round ${d.round}: ${duration(d.seconds)}` }),
      Plot.ruleY([0], { stroke: 'var(--line)' }),
    ],
  }));

  // What each correction found, and what really happened.
  const corrections = (summary.corrections ?? []).filter((one) => one.simulations.length > 0);
  const correctionText = () => {
    const simulated = total(corrections.map((one) => one.simulations.length));
    const dropped = corrections.filter((one) => one.dropped).length;
    return `${corrections.length} corrections, ${simulated} simulated plans${dropped ? `; ${dropped} came too late and were dropped` : ''}.`;
  };
  const correctionChart = chart('Simulated errors of the corrections', (width) => {
    const tried = corrections.flatMap((one) => one.simulations.flatMap((step) => (step.error_mm === null ? [] : [{ segment: one.in_force, error: step.error_mm }])));
    const links = corrections.flatMap((one) => (one.forecast_mm === null || one.corrected_mm === null ? [] : [{ segment: one.in_force, from: one.forecast_mm, to: one.corrected_mm }]));
    return {
      x: { domain: [-0.3, Math.max(1, rounds.length)], ticks: wholeTicks(0, rounds.length, width), tickFormat: 'd', label: 'segments executed when in force' },
      y: { type: 'sqrt', label: 'mm', grid: true, nice: true, domain: [0, Math.max(1, endError, ...tried.map((row) => row.error))] },
      marks: [
        Plot.ruleY([endError], { stroke: 'var(--c0)', strokeWidth: 2 }),
        Plot.link(links, { x: 'segment', y1: 'from', y2: 'to', stroke: 'var(--c1)', strokeWidth: 1.5 }),
        Plot.dot(tried, { x: 'segment', y: 'error', stroke: 'var(--muted)', r: 2.2 }),
        Plot.dot(links, { x: 'segment', y: 'from', fill: 'var(--c2)', symbol: 'square', r: 3 }),
        Plot.dot(links, { x: 'segment', y: 'to', fill: 'var(--c1)', r: 3.4, tip: true, title: (d) => `in force after ${d.segment} segments: ${fixed(d.from, 2)} mm forecast, ${fixed(d.to, 2)} mm corrected` }),
      ],
    };
  }, { seek });

  const names = page.trajectory?.controls ?? rounds[0]?.controls[0]?.map((_, c) => ({ name: `control ${c + 1}`, unit: '' })) ?? [];
  // Lengths per frame are fractions of a millimetre.
  const millimetres = (unit: string) => (unit === 'm' || unit.startsWith('m/') ? 1000 : 1);
  const controlCharts = names.map(({ name, unit }, c) => ({
    name, unit: millimetres(unit) === 1 ? unit : `m${unit}`,
    chart: chart(`${name} over segments`, (width) => {
      const factor = millimetres(unit);
      const done = rounds.map((r, i) => ({ x: i, value: factor * r.controls[0][c] }));
      const plan = (rounds[round]?.controls ?? []).map((row, j) => ({ x: round + j, value: factor * row[c] }));
      const all = rounds.flatMap((r) => r.controls.map((row) => factor * row[c]));
      const low = Math.min(...all), high = Math.max(...all), pad = Math.max(0.06 * (high - low), 0.1 * Math.abs(high), 1e-3);
      // Steps: a control is constant within a segment.
      const steps = (rows: { x: number; value: number }[]) => (rows.length ? [...rows, { x: rows[rows.length - 1].x + 1, value: rows[rows.length - 1].value }] : rows);
      return {
        marginLeft: 52, marginTop: 10,
        x: { domain: [0, Math.max(1, rounds.length, round + plan.length)], ticks: wholeTicks(0, rounds.length, width), tickFormat: 'd', label: 'segments executed' },
        y: { label: null, grid: true, ticks: 4, domain: [low - pad, high + pad], tickFormat: '~g' },
        marks: [
          Plot.lineY(steps(done), { x: 'x', y: 'value', curve: 'step-after', stroke: 'var(--executed)', strokeWidth: 2.2 }),
          Plot.lineY(steps(plan), { x: 'x', y: 'value', curve: 'step-after', stroke: 'var(--planned)', strokeWidth: 1.4, strokeDasharray: '4,3' }),
        ],
      };
    }, { height: 150, seek }),
  }));

  const timeCharts: Chart[] = [errorChart, aheadChart, ...controlCharts.map((one) => one.chart)];
  const roundCharts: Chart[] = rounds.length ? [lossChart, aheadChart, ...controlCharts.map((one) => one.chart)] : [];

  const boundaries = [...rounds.map((_, i) => (i + 1) * perSegment), ...(last > release ? [last] : [])];
  const player = new Player(frames.count, session.frame_seconds, boundaries, describe, showFrame);

  const used = (kind: string) => page.provenance?.plugins?.filter((p) => p.kind === kind).map((p) => p.name).join(', ');
  const width = rounds.length ? rounds[0].knowledge.width : [];
  const knowledge = session.estimates ? 'material estimated while folding' : width.every((w) => w === 0) ? 'material known to the planner' : width.every((w) => w === 1) ? 'material unknown to the planner' : 'material partly known to the planner';
  const result = h('div', {},
    title(page, `Fold of a ${garment.name}`, [
      `${garment.vertices} vertices`, knowledge, worldOf(summary), used('predictor') && `predictor ${used('predictor')}`, used('optimiser') && `optimiser ${used('optimiser')}`,
    ]),
    ...summary.warnings.map((text) => h('p', { class: 'warning', role: 'note' }, `Warning: ${text}`)),
    h('dl', { class: 'tiles' },
      ...(corresponds ? [
        tile('Error after settling', 'error_mm', fixed(endError), 'mm'),
        tile('With the default control', 'default_error_mm', fixed(defaultError), 'mm')] : []),
      ...(summary.chamfer_mm === undefined ? [] : [
        tile('Chamfer distance after settling', 'chamfer_mm', fixed(summary.chamfer_mm), 'mm'),
        tile('With the default control, chamfer', 'default_chamfer_mm', fixed(summary.default_chamfer_mm), 'mm')]),
      ...shapeTiles(summary),
      tile('Segments', 'segments', String(summary.segments), ''),
      tile('First plan', 'first_plan', duration(summary.plan_seconds[0] ?? 0), ''),
      summary.correction_seconds ? tile('Corrections, median', 'corrections', duration(quantile(summary.correction_seconds, 0.5)), '') :
      tile('Later plans, median', 'later_plans', summary.plan_seconds.length > 1 ? duration(quantile(summary.plan_seconds.slice(1), 0.5)) : '–', ''),
      estimated ? tile('Estimates, median', 'estimates', duration(quantile(summary.estimate_seconds, 0.5)), '') : null),
    h('section', { 'aria-label': '3D view and playback' },
      h('div', { class: 'stage' }, h('div', {}, viewer.element, player.element), panel)),
    h('div', { class: 'figures' },
      section('error', 'Distance to the goal', corresponds ? 'Mean over all vertices.' : 'Mean of the nearest distances, in both directions.',
        key({ text: 'cloth as it was', colour: 'var(--c0)', style: 'line' }, { text: 'end that each plan predicted', colour: 'var(--c1)', style: 'line' }, { text: 'end with the default control', colour: 'var(--muted)', style: 'dashed' }),
        errorChart.element),
      section('ahead', 'Prediction against execution', 'The prediction of the chosen round for the segments that followed.',
        key({ text: 'mean distance from the executed shape', colour: 'var(--c0)', style: 'line' }, { text: 'mean predicted σ', colour: 'var(--prediction)' }, { text: 'other rounds', colour: 'var(--muted)', style: 'line' }),
        aheadChart.element),
      h('div', { class: 'wide' }, section('material', session.estimates ? 'What the session learnt about the material' : 'What the planner knew about the material', `Band c ± w/2 and centre c ${session.estimates ? 'estimated after each segment' : 'that each plan was made with'}; ${session.true_material ? 'the dotted line is the true value' : 'nobody knows the true value'}. 0 and 1 are the ends of the range that the material space spans.`,
        h('div', { class: 'small-multiples' }, ...page.properties.map((name, p) => h('div', {},
          h('h3', {}, h('span', { class: 'swatch', style: `background:var(--${name})` }), label(name),
            session.true_material ? h('span', { class: 'sub' }, `true ${fixed(session.true_material[p], 2)}`) : null), knowledgeCharts[p].element))))),
      section('loss', 'Planning loss', null, lossText,
        key({ text: 'winner', colour: 'var(--c1)', style: 'line' }, { text: 'other instances', colour: 'var(--muted)', style: 'line' }), lossChart.element),
      corrections.length === 0 ? null : section('corrections', 'Corrections by the simulator', correctionText(),
        key({ text: 'plan in force, forecast', colour: 'var(--c2)' }, { text: 'best simulated plan', colour: 'var(--c1)' }, { text: 'other simulated plans', colour: 'var(--muted)' }, { text: 'what happened', colour: 'var(--c0)', style: 'line' }),
        correctionChart.element),
      section('time', 'Time', `Planning ${duration(total(summary.plan_seconds))}${estimated ? `, estimating ${duration(total(summary.estimate_seconds))}` : ''}${summary.correction_seconds ? `, correcting ${duration(total(summary.correction_seconds))}` : ''}, executing (simulator) ${duration(summary.simulate_seconds)} in all.`,
        key({ text: 'plan', colour: 'var(--c1)' }, ...(estimated ? [{ text: 'estimate', colour: 'var(--c2)' }] : [])), timeChart.element),
      h('div', { class: 'wide' }, section('controls', 'Controls', 'Per frame, constant within a segment.',
        key({ text: 'executed', colour: 'var(--executed)', style: 'line' }, { text: 'plan of the chosen round', colour: 'var(--planned)', style: 'dashed' }),
        h('div', { class: 'small-multiples' }, ...controlCharts.map((one) => h('div', {}, h('h3', {}, one.name, one.unit && h('span', { class: 'sub' }, one.unit)), one.chart.element)))))),
    h('div', { class: 'details' },
      h('details', { id: 'numbers' }, h('summary', {}, 'Numbers by segment'), h('div', { class: 'scroll', tabindex: 0 }, segmentTable())),
      keysDetails(), ...provenanceDetails(page)));

  function segmentTable() {
    const head = ['Segment', 'Distance to goal, mm', 'Predicted end, mm', 'Predicted 1 ahead, off by mm', 'Plan, s', 'Iterations', ...page.properties.map((name) => `${label(name)} c ± w/2`)];
    return h('table', {}, h('thead', {}, h('tr', {}, ...head.map((text) => h('th', { scope: 'col' }, text)))),
      h('tbody', {}, ...rounds.map((r, i) => h('tr', {},
        ...[String(i + 1), fixed(r.error_mm, 2), fixed(summary.predicted_error_mm[i], 2), fixed(r.prediction.error_mm[0], 2), fixed(summary.plan_seconds[i], 2), String(summary.plan_iterations[i]),
          ...page.properties.map((_, p) => `${fixed(r.knowledge.centre[p], 2)} ± ${fixed(r.knowledge.width[p] / 2, 2)}`)].map((text) => h('td', {}, text))))));
  }
  function keysDetails() {
    const rows: [string, string][] = [
      ['Space', 'play, pause'], ['[ ]', 'one segment back, forward'], [', .', 'one frame back, forward'],
      ['arrows', 'in the 3D view: turn; with shift: move'], ['+ −', 'in the 3D view: zoom (so does the wheel, once the view is clicked)'], ['R 2 3', 'in the 3D view: reset, from the side, from above'],
    ];
    return h('details', {}, h('summary', {}, 'Keys'), h('table', {}, h('tbody', {}, ...rows.map(([keys, text]) =>
      h('tr', {}, h('td', {}, ...keys.split(' ').flatMap((one) => [h('kbd', {}, one), ' '])), h('td', { class: 'text' }, text))))));
  }

  viewer.fit([frames.at(0), frames.at(Math.floor(release / 2)), frames.at(last), goal, ...executedPaths, ...(rounds.length ? plannedPaths(0) : [])]);
  viewer.setLines('executed', executedPaths, 'executed', false);
  const asked = colouringOf(options.get('colour'));
  if (asked) {
    colouring = asked;
    colourSelect.value = asked;
  }
  if (rounds.length) {
    round = -1;
    chooseRound(Math.min(Math.max(0, Number(options.get('round') ?? 1) - 1), rounds.length - 1), false);
  }
  update();
  player.seek(options.has('frame') ? Number(options.get('frame')) : last);
  Object.assign(window, { weft: { viewer, player } });
  return result;
}

/** The errors besides the mean vertex error. */
function shapeTiles(summary: Summary): HTMLElement[] {
  if (summary.max_error_mm === undefined) return [];
  const seenFromAbove = tile('IoU seen from above', 'silhouette_iou', fixed(summary.silhouette_iou, 3), '');
  if (summary.error_mm === null) return summary.silhouette_iou === null ? [] : [seenFromAbove];
  const reached = [10, 20, 30].find((limit) => summary[`success_${limit}mm` as 'success_10mm']);
  return [
    tile('Largest of a vertex', 'max_error_mm', fixed(summary.max_error_mm), 'mm'),
    tile('Held vertices', 'grasped_error_mm', fixed(summary.grasped_error_mm), 'mm'),
    tile('Named vertices', 'named_error_mm', fixed(summary.named_error_mm), 'mm'),
    seenFromAbove,
    tile('Success', 'success', reached ? `within ${reached}` : 'not within 30', 'mm'),
  ];
}

/** Where the world differed from the task. */
function worldOf({ world }: Summary): string | false {
  return !!world && `world: ${[world.spread > 0 && `constants of the fabric ± ${fixed(100 * world.spread, 0)} %`, `simulator ${world.simulator}`].filter(Boolean).join(', ')}`;
}

const colouringOf = (name: string | null): Colouring | null => (name && name in kColourings ? (name as Colouring) : null);
