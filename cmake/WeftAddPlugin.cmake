# A result belongs to the bytes of its plugins' libraries, so these must not depend on the folders of source and build.
function(weft_same_bytes_anywhere target)
  # The last one that fits counts, and the build folder may lie in the source folder.
  target_compile_options(${target} PRIVATE
    -ffile-prefix-map=${CMAKE_SOURCE_DIR}=source -ffile-prefix-map=${CMAKE_BINARY_DIR}=build)
endfunction()

# weft_add_plugin(NAME KIND simulator|predictor|trajectory|optimiser SOURCES ... [LIBRARIES ...] [MARCH x86-64-v3]
#                 [VERSION 1.0.0] [CONFORMANCE file.yaml] [OUTPUT_DIRECTORY folder] [NO_CONFORMANCE_TEST] [NO_INSTALL])
# Builds lib<NAME> as a plugin in the folder where the loader looks, installs it there, and registers
# `weft conformance` on it in ctest. Works in weft's own tree and after find_package(weft).
# NAME, KIND and, if given, VERSION must be those of WEFT_PLUGIN; the compiler says so when they differ.
# Where nobody has chosen a build type it becomes Release: without optimisation the laws of a simulator take minutes.
function(weft_add_plugin name)
  cmake_parse_arguments(ARG "NO_CONFORMANCE_TEST;NO_INSTALL" "KIND;VERSION;MARCH;CONFORMANCE;OUTPUT_DIRECTORY" "SOURCES;LIBRARIES" ${ARGN})
  if(NOT ARG_KIND MATCHES "^(simulator|predictor|trajectory|optimiser)$")
    message(FATAL_ERROR "weft_add_plugin(${name}): KIND is '${ARG_KIND}', must be simulator, predictor, trajectory or optimiser")
  endif()
  if(NOT name MATCHES "^[A-Za-z0-9_-]+$")
    message(FATAL_ERROR "weft_add_plugin(${name}): the name must be letters, digits, _ and -")
  endif()
  if(NOT ARG_OUTPUT_DIRECTORY)
    set(ARG_OUTPUT_DIRECTORY ${CMAKE_BINARY_DIR}/${CMAKE_INSTALL_LIBDIR}/weft/plugins)
  endif()
  get_property(multi_config GLOBAL PROPERTY GENERATOR_IS_MULTI_CONFIG)
  if(NOT CMAKE_BUILD_TYPE AND NOT multi_config AND PROJECT_IS_TOP_LEVEL)
    message(STATUS "weft_add_plugin(${name}): no CMAKE_BUILD_TYPE was given, so it is Release")
    set(CMAKE_BUILD_TYPE Release CACHE STRING "Build type" FORCE)
  endif()
  set(target weft_${ARG_KIND}_${name})
  add_library(${target} MODULE ${ARG_SOURCES})
  set_property(GLOBAL APPEND PROPERTY WEFT_PLUGIN_TARGETS ${target})
  target_link_libraries(${target} PRIVATE weft::framework ${ARG_LIBRARIES})
  target_compile_features(${target} PRIVATE cxx_std_20)
  target_compile_definitions(${target} PRIVATE
    WEFT_PLUGIN_KIND="${ARG_KIND}" WEFT_PLUGIN_NAME="${name}" WEFT_PLUGIN_VERSION="${ARG_VERSION}")
  set_target_properties(${target} PROPERTIES
    PREFIX "lib" OUTPUT_NAME ${target} CXX_VISIBILITY_PRESET hidden VISIBILITY_INLINES_HIDDEN ON
    LIBRARY_OUTPUT_DIRECTORY ${ARG_OUTPUT_DIRECTORY})
  # An installed plugin finds libweft.so two folders up, also after the tree was moved. A plugin that is installed
  # elsewhere finds it in the folder that it was linked from.
  set_property(TARGET ${target} APPEND PROPERTY INSTALL_RPATH "$ORIGIN/../..")
  set_target_properties(${target} PROPERTIES INSTALL_RPATH_USE_LINK_PATH ON)
  if(ARG_MARCH)
    target_compile_options(${target} PRIVATE -march=${ARG_MARCH})
  endif()
  set_target_properties(${target} PROPERTIES BUILD_RPATH_USE_ORIGIN ON)
  if(COMMAND weft_compile_options)
    weft_compile_options(${target})
    set_target_properties(${target} PROPERTIES INSTALL_RPATH "$ORIGIN/../..")  # CMAKE_INSTALL_RPATH is that of programs
    if(NOT ARG_NO_INSTALL)
      # The build tree has the same folders, so installing need not change the file, and with it its hash.
      set_target_properties(${target} PROPERTIES BUILD_WITH_INSTALL_RPATH ON)
    endif()
  else()
    weft_same_bytes_anywhere(${target})
  endif()
  if(ARG_CONFORMANCE)
    # Tolerances live with the plugin: beside the library under the library's name.
    add_custom_command(TARGET ${target} POST_BUILD COMMAND ${CMAKE_COMMAND} -E copy_if_different
      ${CMAKE_CURRENT_SOURCE_DIR}/${ARG_CONFORMANCE} $<TARGET_FILE_DIR:${target}>/lib${target}.conformance.yaml)
  endif()
  if(NOT ARG_NO_INSTALL)
    install(TARGETS ${target} LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR}/weft/plugins)
    if(ARG_CONFORMANCE)
      install(FILES ${ARG_CONFORMANCE} DESTINATION ${CMAKE_INSTALL_LIBDIR}/weft/plugins RENAME lib${target}.conformance.yaml)
    endif()
  endif()
  # Registers nothing unless enable_testing() was called.
  if(NOT ARG_NO_CONFORMANCE_TEST)
    add_test(NAME conformance.${ARG_KIND}.${name} COMMAND $<TARGET_FILE:weft::weft> conformance $<TARGET_FILE:${target}>)
    # weft ends a law that hangs; this is for weft itself, on a busy machine and with sanitizers.
    set_tests_properties(conformance.${ARG_KIND}.${name} PROPERTIES TIMEOUT 3600)
  endif()
endfunction()
