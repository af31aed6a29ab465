# `cpack -G DEB` in the build folder: weft_VERSION_ARCH.deb, and weft-torch_VERSION_ARCH.deb with what needs libtorch
# (training of emd, the plugin torchscript) if it was built. libtorch with its dependencies is several times as large as all
# else, and `weft run` does not need it, so weft only recommends that package.
set(CPACK_PACKAGE_NAME weft)
set(CPACK_PACKAGE_VERSION ${PROJECT_VERSION})
set(CPACK_PACKAGE_VENDOR "The weft authors")
set(CPACK_PACKAGE_CONTACT "The weft authors <weft@weft.invalid>")
set(CPACK_RESOURCE_FILE_LICENSE ${PROJECT_SOURCE_DIR}/LICENSE)
set(CPACK_PACKAGING_INSTALL_PREFIX /usr)
# A result belongs to the bytes of its plugins, and those of a package are those of an installed tree.
set(CPACK_STRIP_FILES OFF)

set(CPACK_COMPONENTS_ALL weft)
set(CPACK_DEBIAN_WEFT_DESCRIPTION "weft plans how a two-handed robot folds a piece of cloth, with a learned model of the cloth. Its simulators, predictors, \
trajectories and optimisers are plugins.")
set(CPACK_DEBIAN_WEFT_PACKAGE_NAME weft)
set(CPACK_DEBIAN_WEFT_PACKAGE_SUGGESTS "g++, cmake, libeigen3-dev, nodejs, librsvg2-bin")  # to write plugins; for --figures
if(TARGET weft_torch)
  list(APPEND CPACK_COMPONENTS_ALL torch)
  set(CPACK_DEBIAN_WEFT_PACKAGE_RECOMMENDS "weft-torch (= ${PROJECT_VERSION})")
  set(CPACK_DEBIAN_TORCH_DESCRIPTION "Training of weft's learned models: the library with which `weft train` and `weft learn` fit the predictor emd, and the predictor torchscript, which runs \
networks that PyTorch wrote.")
  set(CPACK_DEBIAN_TORCH_PACKAGE_NAME weft-torch)
  set(CPACK_DEBIAN_TORCH_PACKAGE_DEPENDS "weft (= ${PROJECT_VERSION})")
  set(CPACK_DEBIAN_TORCH_PACKAGE_RECOMMENDS "libopenblas0-openmp")  # the reference BLAS is 20 times slower
endif()
set(CPACK_DEB_COMPONENT_INSTALL ON)
set(CPACK_DEBIAN_FILE_NAME DEB-DEFAULT)
set(CPACK_DEBIAN_PACKAGE_SECTION science)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS ON)
set(CPACK_DEBIAN_PACKAGE_SHLIBDEPS_PRIVATE_DIRS ${PROJECT_BINARY_DIR}/${CMAKE_INSTALL_LIBDIR})  # libweft.so
include(CPack)
