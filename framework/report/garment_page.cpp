#include "report/garment_page.hpp"

#include "report/page.hpp"
#include "report/page_data.hpp"
#include "sdk/files.hpp"

namespace weft {

std::string garment_head(const ConfigNode& garment, const std::string& name, const std::string& mesh_file) {
  ConfigNode head = ConfigNode::mapping({{"name", ConfigNode::scalar(name)}, {"mesh", ConfigNode::scalar(mesh_file)}});
  for (const char* key : {"rest", "layers", "seams"})
    if (garment.is_mapping() && garment.has(key)) head = head.with(key, garment.at(key));
  return head.to_yaml();
}

std::string garment_page(const std::string& page_template, const GarmentPage& garment) {
  PageData page;
  auto& json = page.json;
  json["kind"] = "garment";
  json["garment"] = {
      {"name", garment.name}, {"vertices", garment.positions.rows()}, {"faces", page.faces(garment.faces)}};
  auto& data = json["mesh"];
  data["file"] = garment.mesh_file;
  data["positions"] = page.shapes({garment.positions});
  data["named"] = garment.vertices;
  data["head"] = garment.head;
  if (garment.positions_before.rows() > 0) {
    data["before"] = {{"vertices", garment.positions_before.rows()},
                      {"faces", page.faces(garment.faces_before)},
                      {"positions", page.shapes({garment.positions_before})}};
    data["findings"] = garment.findings;
  }
  return page.fill(page_template);
}

std::string write_garment_page(const std::filesystem::path& file, const GarmentPage& garment) {
  const auto found = find_report_template();
  if (found.text.empty()) return found.reason;
  write_text(file, garment_page(found.text, garment));
  return "";
}

}  // namespace weft
