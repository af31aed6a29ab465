// Opens exported sessions with three.js' own loaders and says what they found. Bundled by browser.mjs.
import { AnimationMixer, Box3, type Mesh, Vector3 } from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';
// @ts-expect-error: it comes without types
import { USDAParser } from 'three/examples/jsm/loaders/usd/USDAParser.js';
import { USDLoader } from 'three/examples/jsm/loaders/USDLoader.js';

/** Position of one vertex of the cloth at some times, in the file's own frame, and in the world. */
async function lookGltf(base64: string, vertex: number, times: number[]) {
  const bytes = Uint8Array.from(atob(base64), (c) => c.charCodeAt(0));
  const gltf = await new GLTFLoader().parseAsync(bytes.buffer, '');
  const meshes: Mesh[] = [];
  gltf.scene.traverse((object) => {
    if ((object as Mesh).isMesh) meshes.push(object as Mesh);
  });
  const cloth = meshes.find((mesh) => mesh.morphTargetInfluences)!;
  const mixer = new AnimationMixer(gltf.scene);
  mixer.clipAction(gltf.animations[0]).play();
  gltf.scene.updateMatrixWorld(true);
  const positions = times.map((time) => {
    mixer.setTime(time);
    const point = cloth.getVertexPosition(vertex, new Vector3());
    return { local: point.toArray(), world: point.clone().applyMatrix4(cloth.matrixWorld).toArray() };
  });
  return {
    meshes: meshes.map((mesh) => mesh.name), targets: cloth.morphTargetInfluences!.length, seconds: gltf.animations[0].duration, positions,
    vertices: cloth.geometry.attributes.position.count, faces: cloth.geometry.index!.count / 3,
  };
}

/** Name, corners and box in the world of every mesh of a USD text, which three.js shows at its default time; and the times of its points. */
function lookUsd(text: string) {
  const specs = new USDAParser().parseData(text).specsByPath as Record<string, { fields: { timeSamples?: { times: number[]; values: number[][] } } }>;
  const root = new USDLoader().parse(text);
  root.updateMatrixWorld(true);
  const meshes: Mesh[] = [];
  root.traverse((object) => {
    if ((object as Mesh).isMesh) meshes.push(object as Mesh);
  });
  return meshes.map((mesh) => {
    const box = new Box3().setFromObject(mesh);
    const samples = specs[`/weft/${mesh.name}.points`].fields.timeSamples;
    return {
      name: mesh.name, corners: mesh.geometry.index?.count ?? mesh.geometry.attributes.position.count, low: box.min.toArray(), high: box.max.toArray(),
      times: samples?.times, points: samples?.values,
    };
  });
}
Object.assign(window, { lookGltf, lookUsd });
