#include "hdf5_edits.hpp"

#include <hdf5.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <stdexcept>

namespace weft::fuzz {
namespace {

namespace fs = std::filesystem;

/// Takes numbers from the front of the input; zeros when it has ended.
class Bytes {
 public:
  explicit Bytes(std::string_view rest) : rest_(rest) {}
  bool empty() const { return rest_.empty(); }
  unsigned byte() {
    if (rest_.empty()) return 0;
    const auto value = static_cast<unsigned char>(rest_.front());
    rest_.remove_prefix(1);
    return value;
  }
  unsigned below(std::size_t count) { return count == 0 ? 0 : byte() % static_cast<unsigned>(count); }
  std::string text() {
    const std::size_t size = std::min<std::size_t>(byte(), rest_.size());
    std::string taken(rest_.substr(0, size));
    rest_.remove_prefix(size);
    return taken;
  }

 private:
  std::string_view rest_;
};

constexpr hsize_t kExtents[] = {0,
                                1,
                                2,
                                3,
                                4,
                                5,
                                6,
                                7,
                                8,
                                9,
                                10,
                                12,
                                15,
                                26,
                                27,
                                64,
                                100,
                                1000,
                                65536,
                                1u << 20,
                                1u << 30,
                                1u << 31,
                                1ull << 32,
                                1ull << 33,
                                (1ull << 61) + 1,
                                1ull << 62,
                                (1ull << 63) - 1,
                                1ull << 63};
constexpr double kNumbers[] = {0,
                               1,
                               -1,
                               2,
                               3,
                               0.5,
                               1e-300,
                               1e-6,
                               100,
                               1000,
                               65504,
                               1e6,
                               1e9,
                               -1e9,
                               3e38,
                               1e300,
                               -1e300,
                               9007199254740993.0,
                               9.2e18,
                               -9.2e18,
                               std::numeric_limits<double>::quiet_NaN(),
                               std::numeric_limits<double>::infinity(),
                               -std::numeric_limits<double>::infinity()};

hid_t file_with(const std::string& bytes) {
  const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
  H5Pset_fapl_core(access, 1 << 16, 0);
  H5Pset_libver_bounds(access, H5F_LIBVER_EARLIEST, H5F_LIBVER_V18);
  H5Pset_file_image(access, const_cast<char*>(bytes.data()), bytes.size());
  const hid_t file = H5Fopen("edited", H5F_ACC_RDWR, access);
  H5Pclose(access);
  if (file < 0) throw std::runtime_error("the valid file cannot be opened");
  return file;
}

void save(hid_t file, const fs::path& path) {
  H5Fflush(file, H5F_SCOPE_GLOBAL);
  const ssize_t size = H5Fget_file_image(file, nullptr, 0);
  std::string bytes(static_cast<std::size_t>(std::max<ssize_t>(size, 0)), '\0');
  H5Fget_file_image(file, bytes.data(), bytes.size());
  H5Fclose(file);
  std::ofstream(path, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

herr_t collect(hid_t, const char* name, const H5O_info_t*, void* names) {
  if (std::strcmp(name, ".") != 0) static_cast<std::vector<std::string>*>(names)->emplace_back(name);
  return 0;
}

/// A type that a file may have in the place of numbers or texts.
hid_t any_type(Bytes& in) {
  hid_t type = -1;
  switch (in.below(16)) {
    case 0:
      return H5Tcopy(H5T_STD_I8LE);
    case 1:
      return H5Tcopy(H5T_STD_U64BE);
    case 2:
      return H5Tcopy(H5T_STD_I64LE);
    case 3:
      return H5Tcopy(H5T_STD_I32BE);
    case 4:
      return H5Tcopy(H5T_IEEE_F32LE);
    case 5:
      return H5Tcopy(H5T_IEEE_F64BE);
    case 6:  // half precision
      type = H5Tcopy(H5T_IEEE_F32LE);
      H5Tset_fields(type, 15, 10, 5, 0, 10);
      H5Tset_size(type, 2);
      H5Tset_ebias(type, 15);
      return type;
    case 7:
      return H5Tcopy(H5T_NATIVE_LDOUBLE);
    case 8:
      type = H5Tcopy(H5T_C_S1);
      H5Tset_size(type, 1 + in.byte());
      return type;
    case 9:
      type = H5Tcopy(H5T_C_S1);
      H5Tset_size(type, H5T_VARIABLE);
      return type;
    case 10:
      type = H5Tcreate(H5T_COMPOUND, 12);
      H5Tinsert(type, "a", 0, H5T_NATIVE_DOUBLE);
      H5Tinsert(type, "b", 8, H5T_NATIVE_INT);
      return type;
    case 11: {
      type = H5Tenum_create(H5T_NATIVE_INT);
      const int value = 1;
      H5Tenum_insert(type, "one", &value);
      return type;
    }
    case 12: {
      const hsize_t size[1] = {1 + in.below(8)};
      return H5Tarray_create2(H5T_NATIVE_DOUBLE, 1, size);
    }
    case 13:
      return H5Tcreate(H5T_OPAQUE, 1 + in.below(32));
    case 14:
      return H5Tcopy(H5T_STD_B16LE);
    default:  // whole numbers of odd sizes
      type = H5Tcopy(H5T_NATIVE_INT);
      H5Tset_size(type, 1 + in.below(64));
      return type;
  }
}

/// The shape of a dataset, changed a little, or any other.
std::vector<hsize_t> any_shape(Bytes& in, std::vector<hsize_t> shape) {
  const unsigned how = in.below(4);
  if (how == 0) return shape;
  if (how == 1 && !shape.empty()) {
    shape[in.below(shape.size())] = kExtents[in.below(std::size(kExtents))];
  } else if (how == 2) {
    if (in.below(2) == 0 && !shape.empty())
      shape.pop_back();
    else
      shape.push_back(kExtents[in.below(std::size(kExtents))]);
  } else {
    shape.resize(in.below(12));
    for (auto& n : shape) n = kExtents[in.below(std::size(kExtents))];
  }
  return shape;
}

std::vector<hsize_t> shape_of(hid_t file, const std::string& name) {
  std::vector<hsize_t> shape;
  const hid_t set = H5Dopen2(file, name.c_str(), H5P_DEFAULT);
  if (set < 0) return shape;
  const hid_t space = H5Dget_space(set);
  shape.resize(static_cast<std::size_t>(std::max(0, H5Sget_simple_extent_ndims(space))));
  if (!shape.empty()) H5Sget_simple_extent_dims(space, shape.data(), nullptr);
  H5Sclose(space);
  H5Dclose(set);
  return shape;
}

/// The product of extents. @return 0 if it is above `most`; the product itself may be above 2^64.
hsize_t product(const std::vector<hsize_t>& extents, hsize_t most) {
  if (std::find(extents.begin(), extents.end(), 0) != extents.end()) return 0;
  hsize_t count = 1;
  for (const hsize_t n : extents) {
    if (n > most / count) return 0;
    count *= n;
  }
  return count;
}

/// The number of a dataset's values, if this program can change them: libhdf5 needs memory for whole chunks, and for each
/// chunk. @return 0: there are none, or too many.
std::size_t values_of(hid_t file, const std::string& name, hid_t set) {
  constexpr hsize_t kMost = 65536;
  const std::vector<hsize_t> shape = shape_of(file, name);
  std::vector<hsize_t> chunk(shape.size());
  const hid_t options = H5Dget_create_plist(set);
  const bool has_chunks = H5Pget_layout(options) == H5D_CHUNKED;
  if (has_chunks) H5Pget_chunk(options, static_cast<int>(chunk.size()), chunk.data());
  H5Pclose(options);
  return has_chunks && product(chunk, kMost) == 0 ? 0 : product(shape, kMost);
}

/// Fills a dataset that is small enough with numbers of the input.
void fill(hid_t file, const std::string& name, hid_t set, hid_t type, Bytes& in) {
  const std::size_t count = values_of(file, name, set);
  const auto kind = H5Tget_class(type);
  if (count == 0 || count > 4096 || (kind != H5T_INTEGER && kind != H5T_FLOAT)) return;
  const double a = kNumbers[in.below(std::size(kNumbers))], b = kNumbers[in.below(std::size(kNumbers))];
  std::vector<double> values(count, a);
  for (std::size_t i = in.byte(); i < values.size(); i += 1 + i) values[i] = b;
  H5Dwrite(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
}

/// Puts another dataset in the place of a name.
void replace(hid_t file, const std::string& name, Bytes& in) {
  const std::vector<hsize_t> shape = any_shape(in, shape_of(file, name));
  const hid_t type = any_type(in);
  const hid_t options = H5Pcreate(H5P_DATASET_CREATE), links = H5Pcreate(H5P_LINK_CREATE);
  H5Pset_create_intermediate_group(links, 1);
  const unsigned storage = in.below(8);
  std::vector<hsize_t> chunk(shape.size(), 1 + in.below(4));
  if (storage == 7) std::fill(chunk.begin(), chunk.end(), kExtents[in.below(std::size(kExtents))]);
  std::vector<hsize_t> most(shape.size(), H5S_UNLIMITED);
  hid_t space = -1;
  if (shape.empty()) {
    space = H5Screate(in.below(2) == 0 ? H5S_SCALAR : H5S_NULL);
  } else {
    space = H5Screate_simple(static_cast<int>(shape.size()), shape.data(), storage >= 4 ? most.data() : nullptr);
    if (storage >= 2) H5Pset_chunk(options, static_cast<int>(chunk.size()), chunk.data());
    if (storage >= 3) H5Pset_deflate(options, 4);
  }
  if (storage == 1) H5Pset_external(options, "/etc/hostname", 0, H5F_UNLIMITED);
  H5Pset_alloc_time(options, storage == 0 ? H5D_ALLOC_TIME_LATE : H5D_ALLOC_TIME_INCR);
  H5Ldelete(file, name.c_str(), H5P_DEFAULT);
  const hid_t set = H5Dcreate2(file, name.c_str(), type, space, links, options, H5P_DEFAULT);
  if (set >= 0) {
    fill(file, name, set, type, in);
    H5Dclose(set);
  }
  for (const hid_t id : {options, links}) H5Pclose(id);
  H5Sclose(space);
  H5Tclose(type);
}

void write_text(hid_t file, const std::string& name, const std::string& text) {
  H5Ldelete(file, name.c_str(), H5P_DEFAULT);
  const hid_t type = H5Tcopy(H5T_C_S1), space = H5Screate(H5S_SCALAR), links = H5Pcreate(H5P_LINK_CREATE);
  H5Pset_create_intermediate_group(links, 1);
  H5Tset_size(type, std::max<std::size_t>(1, text.size()));
  const hid_t set = H5Dcreate2(file, name.c_str(), type, space, links, H5P_DEFAULT, H5P_DEFAULT);
  if (set >= 0) {
    H5Dwrite(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, text.empty() ? "\0" : text.data());
    H5Dclose(set);
  }
  H5Pclose(links);
  H5Sclose(space);
  H5Tclose(type);
}

/// Changes single values of a dataset of numbers, or characters of a text.
void change_values(hid_t file, const std::string& name, Bytes& in) {
  const hid_t set = H5Dopen2(file, name.c_str(), H5P_DEFAULT);
  if (set < 0) return;
  const hid_t type = H5Dget_type(set);
  const std::size_t count = values_of(file, name, set);
  const auto kind = H5Tget_class(type);
  const bool is_text = kind == H5T_STRING && H5Tis_variable_str(type) <= 0;
  if (is_text && count == 1 && H5Tget_size(type) < 65536) {
    std::string text(H5Tget_size(type), '\0');
    H5Dread(set, type, H5S_ALL, H5S_ALL, H5P_DEFAULT, text.data());
    const std::size_t at = (in.byte() * 256 + in.byte()) % text.size();
    const std::string other = in.text();
    const unsigned how = in.below(3);  // insert, overwrite, or cut
    text = text.substr(0, at) + other + (how == 2 ? "" : text.substr(std::min(text.size(), at + how * other.size())));
    write_text(file, name, text);
  } else if ((kind == H5T_INTEGER || kind == H5T_FLOAT) && count > 0) {
    std::vector<double> values(count);
    H5Dread(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
    for (unsigned changes = 1 + in.below(4); changes > 0; --changes) {
      const std::size_t at = (in.byte() * 256 + in.byte()) % values.size();
      const unsigned how = in.byte();
      values[at] = how < 128 ? kNumbers[how % std::size(kNumbers)] : values[at] + (static_cast<double>(how) - 192);
    }
    H5Dwrite(set, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data());
  }
  H5Tclose(type);
  H5Dclose(set);
}

void edit(hid_t file, const std::vector<std::string>& names, Bytes& in) {
  const unsigned how = in.below(12);
  const std::string name = names[in.below(names.size())];
  const auto other = [&] { return names[in.below(names.size())]; };
  switch (how) {
    case 0:
      H5Ldelete(file, name.c_str(), H5P_DEFAULT);
      break;
    case 1:
      H5Lmove(file, name.c_str(), file, (other() + in.text()).c_str(), H5P_DEFAULT, H5P_DEFAULT);
      break;
    case 2: {
      H5Ldelete(file, name.c_str(), H5P_DEFAULT);
      const hid_t group = H5Gcreate2(file, name.c_str(), H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT);
      if (group >= 0) H5Gclose(group);
      break;
    }
    case 3:
      H5Ldelete(file, name.c_str(), H5P_DEFAULT);
      H5Lcreate_soft(("/" + other()).c_str(), file, name.c_str(), H5P_DEFAULT, H5P_DEFAULT);
      break;
    case 4: {  // one object under two names, or a circle of groups
      const std::string from = other(), to = in.below(2) == 0 ? name : name + "/x";
      if (H5Oexists_by_name(file, from.c_str(), H5P_DEFAULT) > 0) {
        if (to == name && from != name) H5Ldelete(file, name.c_str(), H5P_DEFAULT);
        H5Lcreate_hard(file, from.c_str(), file, to.c_str(), H5P_DEFAULT, H5P_DEFAULT);
      }
      break;
    }
    case 5:
      H5Ldelete(file, name.c_str(), H5P_DEFAULT);
      H5Lcreate_external("/dev/zero", "/x", file, name.c_str(), H5P_DEFAULT, H5P_DEFAULT);
      break;
    case 6:
      write_text(file, name, in.text());
      break;
    case 7: {  // a copy of a group or dataset under a new name
      const std::string to = name.substr(0, name.rfind('/') + 1) + in.text();
      H5Ocopy(file, name.c_str(), file, to.c_str(), H5P_DEFAULT, H5P_DEFAULT);
      break;
    }
    case 8:
    case 9:
      replace(file, name, in);
      break;
    default:
      change_values(file, name, in);
  }
}

}  // namespace

EditedFile::EditedFile(const fs::path& valid) {
  H5Eset_auto2(H5E_DEFAULT, nullptr, nullptr);
  std::ifstream stream(valid, std::ios::binary);
  bytes_.assign(std::istreambuf_iterator<char>(stream), {});
  const hid_t file = file_with(bytes_);
  H5Ovisit(file, H5_INDEX_NAME, H5_ITER_INC, collect, &names_);
  H5Fclose(file);
  std::sort(names_.begin(), names_.end());
}

void EditedFile::write(std::string_view edits, const fs::path& file) const {
  const hid_t id = file_with(bytes_);
  Bytes in(edits);
  for (int i = 0; i < 6 && !in.empty(); ++i) edit(id, names_, in);
  save(id, file);
}

void EditedFile::replace_text(const fs::path& path, const std::string& name, const std::string& text) {
  std::ifstream stream(path, std::ios::binary);
  const std::string bytes{std::istreambuf_iterator<char>(stream), {}};
  const hid_t file = file_with(bytes);
  write_text(file, name, text);
  save(file, path);
}

}  // namespace weft::fuzz
