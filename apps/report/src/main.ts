import { ablationPage } from './ablation';
import { readPage } from './data';
import { h } from './dom';
import { evaluationPage } from './evaluation';
import { garmentPage } from './garment';
import { sessionPage } from './session';

const place = document.getElementById('page')!;
const page = readPage();
if (!page) place.append(h('p', {}, 'This is the empty page that weft fills with results; there are none in it.'));
else if (page.schema !== 'weft report 1') place.append(h('p', {}, `This page cannot show data of the schema ${page.schema}.`));
else if (page.kind === 'session') place.append(sessionPage(page));
else if (page.kind === 'garment') place.append(garmentPage(page));
else if (page.kind === 'ablation') place.append(ablationPage(page));
else place.append(evaluationPage(page));
document.documentElement.dataset.ready = '1';
