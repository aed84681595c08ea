# generated/version.h: version, commit and dirty flag, made anew at every build (provenance of every run).
add_custom_target(turntable_version
  COMMAND ${CMAKE_COMMAND} -DVERSION=${PROJECT_VERSION} -DSOURCE=${CMAKE_SOURCE_DIR}
          -DARAVIS=${aravis_VERSION} -DMODBUS=${modbus_VERSION}
          -DOUTPUT=${CMAKE_BINARY_DIR}/generated/version.h -P ${CMAKE_SOURCE_DIR}/cmake/WriteVersion.cmake
  BYPRODUCTS ${CMAKE_BINARY_DIR}/generated/version.h)
