# Target weft_torch: headers and CPU library of libtorch, where they are installed. Debian's TorchConfig.cmake asks for
# packages that libtorch-dev does not bring; these three are all that is needed.
include_guard(GLOBAL)
find_path(WEFT_TORCH_INCLUDE ATen/ATen.h)
find_library(WEFT_TORCH_CPU torch_cpu)
find_library(WEFT_TORCH_C10 c10)
if(WEFT_TORCH_INCLUDE AND WEFT_TORCH_CPU AND WEFT_TORCH_C10)
  add_library(weft_torch INTERFACE IMPORTED GLOBAL)
  target_include_directories(weft_torch SYSTEM INTERFACE ${WEFT_TORCH_INCLUDE})
  target_link_libraries(weft_torch INTERFACE ${WEFT_TORCH_CPU} ${WEFT_TORCH_C10})
  find_path(WEFT_GLOO_INCLUDE gloo/algorithm.h)  # its library is part of libtorch's
  message(STATUS "libtorch: ${WEFT_TORCH_CPU}, headers of Gloo: ${WEFT_GLOO_INCLUDE}")
else()
  message(STATUS "no libtorch (Debian: libtorch-dev): emd predicts with model files but cannot train them; no torchscript")
endif()
