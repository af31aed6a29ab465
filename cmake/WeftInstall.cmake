# cmake --install: the program, the framework library and its headers, the plugins (weft_add_plugin installs each),
# configs under share/weft, documents and the example plugins under share/doc/weft, and a package config for
# find_package(weft). The installed tree can be moved.
include(CMakePackageConfigHelpers)

install(TARGETS weft_framework EXPORT weftTargets LIBRARY DESTINATION ${CMAKE_INSTALL_LIBDIR})
install(TARGETS weft_cli EXPORT weftTargets RUNTIME DESTINATION ${CMAKE_INSTALL_BINDIR})
install(DIRECTORY ${PROJECT_SOURCE_DIR}/framework/include/weft DESTINATION ${CMAKE_INSTALL_INCLUDEDIR} FILES_MATCHING PATTERN "*.hpp")
if(EXISTS ${PROJECT_SOURCE_DIR}/configs)
  install(DIRECTORY ${PROJECT_SOURCE_DIR}/configs DESTINATION ${CMAKE_INSTALL_DATADIR}/weft)
endif()
# Completion for shells, as the program itself prints it.
set(completion ${PROJECT_BINARY_DIR}/completion)
install(CODE "
file(MAKE_DIRECTORY \"${completion}\")
foreach(shell bash zsh)
  execute_process(COMMAND \"$<TARGET_FILE:weft_cli>\" completion \${shell} OUTPUT_FILE \"${completion}/\${shell}\"
                  COMMAND_ERROR_IS_FATAL ANY)
endforeach()")
install(FILES ${completion}/bash DESTINATION ${CMAKE_INSTALL_DATADIR}/bash-completion/completions RENAME weft)
install(FILES ${completion}/zsh DESTINATION ${CMAKE_INSTALL_DATADIR}/zsh/site-functions RENAME _weft)
# The documents keep their places to one another, so that links between them work.
install(FILES ${PROJECT_SOURCE_DIR}/README.md ${PROJECT_SOURCE_DIR}/CHANGELOG.md ${PROJECT_SOURCE_DIR}/MIGRATION.md
              ${PROJECT_SOURCE_DIR}/CONTRIBUTING.md ${PROJECT_SOURCE_DIR}/CITATION.cff ${PROJECT_SOURCE_DIR}/LICENSE DESTINATION ${CMAKE_INSTALL_DOCDIR})
install(DIRECTORY ${PROJECT_SOURCE_DIR}/docs DESTINATION ${CMAKE_INSTALL_DOCDIR})
file(GLOB readmes CONFIGURE_DEPENDS RELATIVE ${PROJECT_SOURCE_DIR} ${PROJECT_SOURCE_DIR}/plugins/*/*/README.md)
foreach(readme ${readmes})
  get_filename_component(folder ${readme} DIRECTORY)
  install(FILES ${PROJECT_SOURCE_DIR}/${readme} DESTINATION ${CMAKE_INSTALL_DOCDIR}/${folder})
endforeach()
# One complete plugin of each kind, as the package test builds them: a project of its own.
install(DIRECTORY ${PROJECT_SOURCE_DIR}/tests/package/plugins/ DESTINATION ${CMAKE_INSTALL_DOCDIR}/examples)

# The build tree has the package config where the install tree has it, so plugins can be built against either.
# A build folder of an earlier version has the package config in its root, where find_package() would find it first.
file(REMOVE ${PROJECT_BINARY_DIR}/weftConfig.cmake ${PROJECT_BINARY_DIR}/weftConfigVersion.cmake)
set(package_folder ${CMAKE_INSTALL_LIBDIR}/cmake/weft)
set(package ${PROJECT_BINARY_DIR}/${package_folder})
configure_package_config_file(${CMAKE_CURRENT_LIST_DIR}/weftConfig.cmake.in ${package}/weftConfig.cmake
  INSTALL_DESTINATION ${package_folder} PATH_VARS CMAKE_INSTALL_DATADIR CMAKE_INSTALL_LIBDIR)
write_basic_package_version_file(${package}/weftConfigVersion.cmake COMPATIBILITY SameMinorVersion)
configure_file(${CMAKE_CURRENT_LIST_DIR}/WeftAddPlugin.cmake ${package}/WeftAddPlugin.cmake COPYONLY)
install(FILES ${package}/weftConfig.cmake ${package}/weftConfigVersion.cmake ${package}/WeftAddPlugin.cmake
        DESTINATION ${package_folder})
install(EXPORT weftTargets NAMESPACE weft:: DESTINATION ${package_folder})
export(EXPORT weftTargets NAMESPACE weft:: FILE ${package}/weftTargets.cmake)
if(EXISTS ${PROJECT_SOURCE_DIR}/configs)
  file(MAKE_DIRECTORY ${PROJECT_BINARY_DIR}/${CMAKE_INSTALL_DATADIR}/weft)
  file(CREATE_LINK ${PROJECT_SOURCE_DIR}/configs ${PROJECT_BINARY_DIR}/${CMAKE_INSTALL_DATADIR}/weft/configs SYMBOLIC)
endif()
