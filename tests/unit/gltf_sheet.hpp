#pragma once

namespace weft::test {

/// A square of 0.6 m, flat in glTF's frame, which is metres with y up. A node moves it up by a metre.
inline constexpr const char* kGltfSheet =
    R"({"asset":{"version":"2.0"},"scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0,"translation":[0,1,0]}],)"
    R"("meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1}]}],"buffers":[{"byteLength":60,"uri":)"
    R"("data:application/octet-stream;base64,AAAAAAAAAAAAAAAAmpkZPwAAAAAAAAAAmpkZPwAAAACamRm/AAAAAAAAAACamRm/)"
    R"(AAABAAIAAAACAAMA"}],"bufferViews":[{"buffer":0,"byteOffset":0,"byteLength":48},{"buffer":0,"byteOffset":48,)"
    R"("byteLength":12}],"accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[0,0,-0.6],)"
    R"("max":[0.6,0,0]},{"bufferView":1,"componentType":5123,"count":6,"type":"SCALAR"}]})";

}  // namespace weft::test
