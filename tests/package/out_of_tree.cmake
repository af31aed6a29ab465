cmake_minimum_required(VERSION 3.25)
# Run with -P. BUILD: weft's build tree; PLUGINS: the out-of-tree project in weft's sources; WORK: scratch folder, emptied
# first.
function(run)
  list(JOIN ARGN " " line)
  message(STATUS "${line}")
  execute_process(COMMAND ${ARGN} RESULT_VARIABLE code OUTPUT_VARIABLE output ERROR_VARIABLE output)
  set(output "${output}" PARENT_SCOPE)
  if(code)
    message(FATAL_ERROR "exit code ${code}\n${output}")
  endif()
endfunction()

# The environment of somebody who only has the installed tree.
foreach(variable WEFT_PLUGIN_PATH LD_LIBRARY_PATH CMAKE_PREFIX_PATH CMAKE_BUILD_TYPE DESTDIR)
  unset(ENV{${variable}})
endforeach()
file(REMOVE_RECURSE ${WORK})

# Installed here, used there: the tree can be moved.
run(${CMAKE_COMMAND} --install ${BUILD} --prefix ${WORK}/installed)
file(RENAME ${WORK}/installed ${WORK}/prefix)
set(weft ${WORK}/prefix/bin/weft)
run(${weft} plugins)
if(output MATCHES "refused" OR NOT output MATCHES "trajectory +arc .*${WORK}/prefix/")
  message(FATAL_ERROR "the moved tree does not load its own plugins:\n${output}")
endif()

# An installed plugin finds libweft.so of its own tree by its RUNPATH, without the program's help.
function(expect_own_library plugin)
  file(GET_RUNTIME_DEPENDENCIES MODULES ${plugin} RESOLVED_DEPENDENCIES_VAR found UNRESOLVED_DEPENDENCIES_VAR missing
       PRE_EXCLUDE_REGEXES "^lib(stdc|gcc|c\\.|m\\.)|^ld-" POST_EXCLUDE_REGEXES "^/(usr/)?lib")
  if(NOT found MATCHES "${WORK}/prefix/lib[^;]*/libweft\\.so" OR missing)
    message(FATAL_ERROR "${plugin} does not find libweft.so of its own tree, but '${found}'; missing: '${missing}'")
  endif()
endfunction()
file(GLOB_RECURSE arc ${WORK}/prefix/lib*/*weft_trajectory_arc.so)
expect_own_library(${arc})

# The installed documents; the rest of this test builds the installed examples.
set(documents ${WORK}/prefix/share/doc/weft)
foreach(file README.md MIGRATION.md docs/write-a-plugin.md docs/images/fold.png plugins/trajectory/arc/README.md)
  if(NOT EXISTS ${documents}/${file})
    message(FATAL_ERROR "${file} is not installed in ${documents}")
  endif()
endforeach()
file(GLOB sources RELATIVE ${PLUGINS} ${PLUGINS}/*)
foreach(file ${sources})
  run(${CMAKE_COMMAND} -E compare_files ${PLUGINS}/${file} ${documents}/examples/${file})
endforeach()
set(PLUGINS ${documents}/examples)

# As the documents write it: nobody says a build type.
set(configure ${CMAKE_COMMAND} -S ${PLUGINS} -G ${GENERATOR} -DCMAKE_CXX_COMPILER=${CXX} -DCMAKE_EXPORT_COMPILE_COMMANDS=ON
    -DCMAKE_CXX_COMPILER_LAUNCHER=${LAUNCHER} -DCMAKE_CXX_FLAGS=${FLAGS} -DCMAKE_PREFIX_PATH=${WORK}/prefix)
run(${configure} -B ${WORK}/build)
file(READ ${WORK}/build/compile_commands.json commands)
if(NOT output MATCHES "no CMAKE_BUILD_TYPE was given, so it is Release" OR NOT commands MATCHES " -O3 ")
  message(FATAL_ERROR "plugins are not optimised by default:\n${output}\n${commands}")
endif()
run(${configure} -B ${WORK}/debug -DCMAKE_BUILD_TYPE=Debug)
file(READ ${WORK}/debug/compile_commands.json commands)
if(NOT commands MATCHES " -g " OR commands MATCHES " -O3 ")
  message(FATAL_ERROR "a build type that was given is not kept:\n${commands}")
endif()
file(STRINGS ${WORK}/build/CMakeCache.txt found REGEX "^weft_DIR:")
if(NOT found MATCHES "=${WORK}/prefix/")
  message(FATAL_ERROR "find_package(weft) found another one: ${found}")
endif()
run(${CMAKE_COMMAND} --build ${WORK}/build)

# The laws, registered in ctest by weft_add_plugin().
run(${CMAKE_CTEST_COMMAND} --test-dir ${WORK}/build --output-on-failure --no-tests=error)
message(STATUS "${output}")
foreach(test trajectory.min_jerk optimiser.momentum predictor.follow simulator.mass_spring)
  if(NOT output MATCHES "conformance.${test} \\.+ +Passed")
    message(FATAL_ERROR "conformance.${test} did not run")
  endif()
endforeach()

# A session, the plugins found through WEFT_PLUGIN_PATH.
set(garment garment=${WORK}/prefix/share/weft/configs/garments/towel.yaml)
file(GLOB_RECURSE found ${WORK}/build/*weft_trajectory_min_jerk.so)
get_filename_component(folder "${found}" DIRECTORY)
set(ENV{WEFT_PLUGIN_PATH} ${folder})
run(${weft} run ${PLUGINS}/fold.yaml --set ${garment} --out ${WORK}/session)
message(STATUS "${output}")
file(READ ${WORK}/session/summary.json summary)
string(JSON error GET "${summary}" error_mm)
string(JSON default_error GET "${summary}" default_error_mm)
if(NOT error LESS default_error)
  message(FATAL_ERROR "the session ends ${error} mm off the goal, the default control ${default_error} mm")
endif()

# momentum needs gradients, which follow has not: a plan with the simulator as predictor.
run(${weft} plan ${PLUGINS}/fold.yaml --set ${garment} --set predictor=rollout --set optimiser=momentum
    --set planning.instances=1 --set planning.iterations=3 --out ${WORK}/plan)
message(STATUS "${output}")
file(READ ${WORK}/plan/plan.json plan)
string(JSON error GET "${plan}" predicted_error_mm)
if(NOT error LESS default_error)
  message(FATAL_ERROR "the plan is predicted to end ${error} mm off the goal, the default control ${default_error} mm")
endif()

# A shipped task with a simulator that has one stiffness for warp and weft: its fabric is refused, with the key, ...
set(configs ${WORK}/prefix/share/weft/configs)
set(task ${configs}/tasks/towel_fold.yaml --set simulator.plugin=mass_spring
    --set garment=${configs}/garments/towel_coarse.yaml --set planning.instances=1 --set planning.iterations=1
    --set planning.replan_iterations=1 --out ${WORK}/shipped)
execute_process(COMMAND ${weft} run ${task} RESULT_VARIABLE code OUTPUT_VARIABLE output ERROR_VARIABLE output)
if(NOT code EQUAL 2 OR NOT output MATCHES "mass_spring: fabric.stretch_n_per_m = {warp: .*must be equal")
  message(FATAL_ERROR "exit code ${code}, where a fabric with warp != weft had to be refused:\n${output}")
endif()
# ... and it runs on the material that has both equal.
run(${weft} run ${task} --set material=${configs}/fabrics/basic_isotropic.yaml)

# And installed beside weft's own, without the variable.
unset(ENV{WEFT_PLUGIN_PATH})
run(${CMAKE_COMMAND} --install ${WORK}/build --prefix ${WORK}/prefix)
foreach(name trajectory/min_jerk optimiser/momentum predictor/follow simulator/mass_spring)
  run(${weft} describe ${name})
  if(NOT output MATCHES "${WORK}/prefix/")
    message(FATAL_ERROR "${name} was found elsewhere:\n${output}")
  endif()
  string(REPLACE "/" "_" library ${name})
  file(GLOB_RECURSE installed ${WORK}/prefix/lib*/*weft_${library}.so)
  expect_own_library(${installed})
endforeach()
