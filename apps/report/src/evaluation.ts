// Pages of `weft evaluate`, for whichever results are there.
import type { PageData } from './data';
import { h } from './dom';
import { estimationPart } from './estimation';
import { provenanceDetails, title } from './frame';
import { physicsPart } from './physics';
import { planningPart } from './planning';
import { predictionPart } from './prediction';

export function evaluationPage(page: PageData): HTMLElement {
  const { planning, estimation, prediction, physics } = page;
  const kinds = [planning && 'planning', estimation && 'estimation', prediction && 'prediction', physics && 'physics'].filter(Boolean) as string[];
  return h('div', {},
    title(page, `Evaluation of ${kinds.join(', ').replace(/, ([^,]*)$/, ' and $1')}`, [page.garment?.name]),
    planning ? planningPart(page, planning) : null,
    estimation ? estimationPart(page, estimation) : null,
    prediction ? predictionPart(page, prediction) : null,
    physics ? physicsPart(physics) : null,
    h('div', { class: 'details' }, ...provenanceDetails(page)));
}
