# The same digits in every run: OpenCV (camera calibration) and SuiteSparse (behind Ceres) take whatever LAPACK the
# machine prefers, and ATLAS, which Debian's libceres-dev brings along, answers differently from run to run, in the last
# digits. The reference LAPACK, which is always there, is linked by name, so that it is loaded first and serves them all.
set(reference_lapack)
foreach(library lapack blas)
  find_library(REFERENCE_${library} NAMES lib${library}.so.3 PATH_SUFFIXES ${library})
  if(REFERENCE_${library})
    list(APPEND reference_lapack ${REFERENCE_${library}})
  endif()
endforeach()
# Ceres and SuiteSparse name ATLAS in their targets; the static library does with any LAPACK.
find_library(CHOLMOD_LIBRARY cholmod REQUIRED)
find_library(SPQR_LIBRARY spqr REQUIRED)
find_library(CXSPARSE_LIBRARY cxsparse REQUIRED)
set_target_properties(Ceres::ceres PROPERTIES INTERFACE_LINK_LIBRARIES
  "Threads::Threads;glog::glog;${SPQR_LIBRARY};${CHOLMOD_LIBRARY};${CXSPARSE_LIBRARY};${reference_lapack};Eigen3::Eigen")
