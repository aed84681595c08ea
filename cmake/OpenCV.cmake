# The OpenCV modules the project uses, without Debian's libopencv-dev (which brings Qt, VTK and 300
# packages more): opencv::imgproc, opencv::imgcodecs, opencv::calib3d, opencv::videoio.
find_path(OPENCV_INCLUDE opencv2/core.hpp PATH_SUFFIXES opencv4 REQUIRED)
foreach(module core imgproc imgcodecs features2d calib3d videoio)
  find_library(OPENCV_${module} opencv_${module} REQUIRED)
  add_library(opencv::${module} UNKNOWN IMPORTED)
  set_target_properties(opencv::${module} PROPERTIES IMPORTED_LOCATION ${OPENCV_${module}}
    INTERFACE_INCLUDE_DIRECTORIES ${OPENCV_INCLUDE})
endforeach()
target_link_libraries(opencv::core INTERFACE ${reference_lapack})
target_link_options(opencv::core INTERFACE -Wl,--no-as-needed)  # nobody here calls BLAS by itself
target_link_libraries(opencv::imgproc INTERFACE opencv::core)
target_link_libraries(opencv::imgcodecs INTERFACE opencv::core)
target_link_libraries(opencv::features2d INTERFACE opencv::imgproc)
# Its header takes detectors of features2d, which Debian installs with it.
target_link_libraries(opencv::calib3d INTERFACE opencv::core opencv::imgproc opencv::features2d)
target_link_libraries(opencv::videoio INTERFACE opencv::core)
