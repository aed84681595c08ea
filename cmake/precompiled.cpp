// Owns the precompiled headers (CMakeLists.txt).
