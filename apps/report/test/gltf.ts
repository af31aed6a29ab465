// Opens an exported session with three.js' own loader and says what it found. Bundled by browser.mjs.
import { AnimationMixer, type Mesh, Vector3 } from 'three';
import { GLTFLoader } from 'three/examples/jsm/loaders/GLTFLoader.js';

/** Position of one vertex of the cloth at some times, in the file's own frame, and in the world. */
async function look(base64: string, vertex: number, times: number[]) {
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
Object.assign(window, { look });
