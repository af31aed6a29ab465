# Run with -P. Without node, and without a network, the build continues and says why there is no page.
# REPORT: apps/report; SCRIPT: cmake/WeftReport.cmake; WORK: scratch folder, emptied first; GENERATOR, MAKE.
file(REMOVE_RECURSE ${WORK})
function(expect_reason folder reason)
  if(EXISTS ${folder}/report.html)
    message(FATAL_ERROR "there is a page in ${folder}")
  endif()
  file(READ ${folder}/why-not.txt text)
  if(NOT text MATCHES "${reason}")
    message(FATAL_ERROR "why-not.txt says '${text}', not '${reason}'")
  endif()
endfunction()

# No program is found outside the folders that a variable names.
execute_process(COMMAND ${CMAKE_COMMAND} -S ${CMAKE_CURRENT_LIST_DIR} -B ${WORK}/no-node -DREPORT=${REPORT}
    -G ${GENERATOR} -DCMAKE_MAKE_PROGRAM=${MAKE} -DCMAKE_FIND_USE_SYSTEM_ENVIRONMENT_PATH=OFF -DCMAKE_FIND_USE_CMAKE_SYSTEM_PATH=OFF
  COMMAND_ERROR_IS_FATAL ANY)
execute_process(COMMAND ${CMAKE_COMMAND} --build ${WORK}/no-node COMMAND_ERROR_IS_FATAL ANY)
expect_reason(${WORK}/no-node/share/weft/report "node and npm were missing when weft was configured; install them")

# An npm that fails, and an old page that must not survive it.
file(WRITE ${WORK}/offline/share/report.html "old")
execute_process(COMMAND ${CMAKE_COMMAND} -DNODE=false -DNPM=false -DSOURCE=${REPORT} -DWORK=${WORK}/offline/work -DTESTS=OFF
    -DOUTPUT=${WORK}/offline/share -DSTAMP=${WORK}/offline/stamp -P ${SCRIPT}
  COMMAND_ERROR_IS_FATAL ANY)
expect_reason(${WORK}/offline/share "npm could not fetch the packages")
if(NOT EXISTS ${WORK}/offline/stamp)
  message(FATAL_ERROR "the build would try again every time")
endif()
