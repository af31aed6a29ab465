cmake_minimum_required(VERSION 3.25)
# Run with -P. Checks that containers/Dockerfile and containers/weft.def are those that cmake/debian-packages.txt and this file
# make; with -DUPDATE=ON, writes them. ROOT: the source tree.
set(groups build torch mesh page)
file(STRINGS ${ROOT}/cmake/debian-packages.txt lines REGEX "^[a-z]+ ")
set(packages)
foreach(line ${lines})
  if(NOT line MATCHES "^([a-z]+) +([^ ]+)")
    message(FATAL_ERROR "cmake/debian-packages.txt: ${line}")
  endif()
  set(group ${CMAKE_MATCH_1})
  set(package ${CMAKE_MATCH_2})
  if(group IN_LIST groups)
    list(APPEND packages ${package})
  endif()
endforeach()
list(JOIN packages " \\\n      " packages)

# The same lines of shell in both.
set(install "apt-get update && DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends ca-certificates git \\\n      ${packages} && \\\n    rm -rf /var/lib/apt/lists/*")
set(build "cmake -S /opt/weft -B /tmp/build -G Ninja -DCMAKE_BUILD_TYPE=Release -DWEFT_BUILD_TESTS=OFF && \\\n    cmake --build /tmp/build && cmake --install /tmp/build --prefix /usr/local && ldconfig && \\\n    rm -rf /tmp/build /opt/weft && weft --version")
set(made "# Made by cmake/WeftContainers.cmake from cmake/debian-packages.txt; not edited by hand.\n")

set(dockerfile "${made}# In the folder of weft's sources: docker build -f containers/Dockerfile -t weft .
FROM debian:12
RUN ${install}
COPY . /opt/weft
RUN ${build}
CMD [\"weft\", \"--help\"]
")
set(definition "${made}# In the folder of weft's sources: apptainer build weft.sif containers/weft.def
Bootstrap: docker
From: debian:12

%files
    . /opt/weft

%post
    ${install}
    ${build}

%runscript
    exec weft \"$@\"
")
foreach(file Dockerfile weft.def)
  if(file STREQUAL "Dockerfile")
    set(text "${dockerfile}")
  else()
    set(text "${definition}")
  endif()
  set(path ${ROOT}/containers/${file})
  if(UPDATE)
    file(WRITE ${path} "${text}")
    continue()
  endif()
  set(there "")
  if(EXISTS ${path})
    file(READ ${path} there)
  endif()
  if(NOT there STREQUAL text)
    message(FATAL_ERROR "containers/${file} is not what cmake/debian-packages.txt asks for; run cmake -DROOT=. -DUPDATE=ON -P cmake/WeftContainers.cmake")
  endif()
endforeach()
