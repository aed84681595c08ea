// A library to be preloaded (LD_PRELOAD): lets file calls of a program fail as a full disk, a network share or a process
// out of descriptors lets them fail. Only calls on paths below a given folder count. By environment:
//   FILE_FAULTS_UNDER  folder, absolute and without links; nothing is counted without it
//   FILE_FAULTS_LOG    file that gets a line "<kind> <number> <path>" for every call counted, and a line
//                      "! <kind> <number> <path>" for every one that was made to fail
//   FILE_FAULTS_CALL   kinds of the calls that fail, with commas: open, read, write, sync, dirsync (sync of a folder),
//                      rename, close, unlink, mkdir, truncate, stat, list (opendir)
//   FILE_FAULTS_AT     the how many-th call of these kinds fails, from 1
//   FILE_FAULTS_ERRNO  with which error, as a number; 0 = a write writes only half of what it was given
//   FILE_FAULTS_ALWAYS if set, all further calls of these kinds fail too
// Children of the program (gnuplot, Chromium) are left in peace.
#include <dirent.h>
#include <dlfcn.h>
#include <fcntl.h>
#include <limits.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstdarg>
#include <cstdio>
#include <cstdlib>
#include <cstring>

namespace {

enum Kind {
  kOpen,
  kRead,
  kWrite,
  kSync,
  kDirSync,
  kRename,
  kClose,
  kUnlink,
  kMkdir,
  kTruncate,
  kStat,
  kList,
  kKinds
};
constexpr std::array<const char*, kKinds> kNames{"open",    "read",     "write", "sync",
                                                 "dirsync", "rename",   "close", "unlink",
                                                 "mkdir",   "truncate", "stat",  "list"};

struct Order {
  char under[PATH_MAX] = "";
  std::size_t under_size = 0;
  int log = -1;
  std::array<bool, kKinds> kinds{};
  long at = 0;
  int error = 0;
  bool always = false;
};
Order order;
std::array<std::atomic<long>, kKinds> counts;
std::atomic<long> count;  // of the kinds that are to fail

template <class F>
F real(F, const char* name) {
  return reinterpret_cast<F>(::dlsym(RTLD_NEXT, name));
}
#define REAL(name) static const auto next = real(&::name, #name)

__attribute__((constructor)) void read_order() {
  ::unsetenv("LD_PRELOAD");
  const char* under = std::getenv("FILE_FAULTS_UNDER");
  if (under == nullptr) return;
  if (const char* log = std::getenv("FILE_FAULTS_LOG"))
    order.log = static_cast<int>(
        ::syscall(SYS_openat, AT_FDCWD, log, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644));
  for (const char* call = std::getenv("FILE_FAULTS_CALL"); call != nullptr && *call != '\0';) {
    const std::size_t size = std::strcspn(call, ",");
    for (std::size_t i = 0; i < kKinds; ++i)
      if (std::strlen(kNames[i]) == size && std::strncmp(call, kNames[i], size) == 0)
        order.kinds[i] = true;
    call += call[size] == ',' ? size + 1 : size;
  }
  const char* at = std::getenv("FILE_FAULTS_AT");
  const char* error = std::getenv("FILE_FAULTS_ERRNO");
  order.at = at != nullptr ? std::atol(at) : 0;
  order.error = error != nullptr ? std::atoi(error) : 0;
  order.always = std::getenv("FILE_FAULTS_ALWAYS") != nullptr;
  std::snprintf(order.under, sizeof order.under, "%s", under);
  order.under_size = std::strlen(order.under);
}

void say(const char* mark, Kind kind, long number, const char* path) {
  if (order.log < 0) return;
  char line[PATH_MAX + 64];
  const int size =
      std::snprintf(line, sizeof line, "%s%s %ld %s\n", mark, kNames[kind], number, path);
  ::syscall(SYS_write, order.log, line, static_cast<std::size_t>(size));
}

/// @param path absolute. @return whether this call shall fail, with `errno` set.
bool counted(Kind kind, const char* path) {
  if (order.under_size == 0 || std::strncmp(path, order.under, order.under_size) != 0) return false;
  if (path[order.under_size] != '/' && path[order.under_size] != '\0') return false;
  const long number = ++counts[kind];
  say("", kind, number, path);
  const long mine = order.kinds[kind] ? ++count : 0;
  if (order.at == 0 || mine == 0 || (order.always ? mine < order.at : mine != order.at))
    return false;
  say("! ", kind, number, path);
  errno = order.error;
  return true;
}

bool fails(Kind kind, int folder, const char* path) {
  if (order.under_size == 0 || path == nullptr) return false;
  const int before = errno;
  char whole[2 * PATH_MAX];
  if (path[0] == '/') {
    std::snprintf(whole, sizeof whole, "%s", path);
  } else {
    char base[PATH_MAX] = "";
    if (folder == AT_FDCWD) {
      if (::getcwd(base, sizeof base) == nullptr) base[0] = '\0';
    } else {
      char link[64];
      std::snprintf(link, sizeof link, "/proc/self/fd/%d", folder);
      const ssize_t n = ::readlink(link, base, sizeof base - 1);
      base[n > 0 ? n : 0] = '\0';
    }
    std::snprintf(whole, sizeof whole, "%s/%s", base, path);
  }
  if (counted(kind, whole)) return true;
  errno = before;
  return false;
}

bool fails(Kind kind, int fd) {
  if (order.under_size == 0) return false;
  const int before = errno;
  char link[64], path[PATH_MAX];
  std::snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
  const ssize_t n = ::readlink(link, path, sizeof path - 1);
  path[n > 0 ? n : 0] = '\0';
  if (kind == kSync) {
    struct stat about {};
    if (::syscall(SYS_fstat, fd, &about) == 0 && S_ISDIR(about.st_mode)) kind = kDirSync;
  }
  if (n > 0 && counted(kind, path)) return true;
  errno = before;
  return false;
}

mode_t mode_of(int flags, va_list list) {
  return (flags & (O_CREAT | O_TMPFILE)) != 0 ? static_cast<mode_t>(va_arg(list, int)) : 0;
}

}  // namespace

extern "C" {

#define OPEN(name)                                                      \
  int name(const char* path, int flags, ...) {                          \
    REAL(name);                                                         \
    va_list list;                                                       \
    va_start(list, flags);                                              \
    const mode_t mode = mode_of(flags, list);                           \
    va_end(list);                                                       \
    return fails(kOpen, AT_FDCWD, path) ? -1 : next(path, flags, mode); \
  }
OPEN(open)
OPEN(open64)
#define OPENAT(name)                                                          \
  int name(int folder, const char* path, int flags, ...) {                    \
    REAL(name);                                                               \
    va_list list;                                                             \
    va_start(list, flags);                                                    \
    const mode_t mode = mode_of(flags, list);                                 \
    va_end(list);                                                             \
    return fails(kOpen, folder, path) ? -1 : next(folder, path, flags, mode); \
  }
OPENAT(openat)
OPENAT(openat64)
#define FOPEN(name)                                                   \
  FILE* name(const char* path, const char* mode) {                    \
    REAL(name);                                                       \
    return fails(kOpen, AT_FDCWD, path) ? nullptr : next(path, mode); \
  }
FOPEN(fopen)
FOPEN(fopen64)
DIR* opendir(const char* path) {
  REAL(opendir);
  return fails(kList, AT_FDCWD, path) ? nullptr : next(path);
}

ssize_t read(int fd, void* to, size_t size) {
  REAL(read);
  return fails(kRead, fd) ? -1 : next(fd, to, size);
}
ssize_t write(int fd, const void* from, size_t size) {
  REAL(write);
  if (!fails(kWrite, fd)) return next(fd, from, size);
  return order.error == 0 && size > 1 ? next(fd, from, size / 2)
         : order.error == 0           ? next(fd, from, size)
                                      : -1;
}
ssize_t pwrite(int fd, const void* from, size_t size, off_t at) {
  REAL(pwrite);
  return fails(kWrite, fd) ? -1 : next(fd, from, size, at);
}
ssize_t pwrite64(int fd, const void* from, size_t size, off64_t at) {
  REAL(pwrite64);
  return fails(kWrite, fd) ? -1 : next(fd, from, size, at);
}
ssize_t writev(int fd, const iovec* pieces, int count) {
  REAL(writev);
  if (!fails(kWrite, fd)) return next(fd, pieces, count);
  return order.error == 0 ? next(fd, pieces, 1) : -1;
}
int fsync(int fd) {
  REAL(fsync);
  return fails(kSync, fd) ? -1 : next(fd);
}
int fdatasync(int fd) {
  REAL(fdatasync);
  return fails(kSync, fd) ? -1 : next(fd);
}
// Like the kernel's: the descriptor is gone, whatever the error says.
int close(int fd) {
  REAL(close);
  if (!fails(kClose, fd)) return next(fd);
  next(fd);
  errno = order.error;
  return -1;
}
int fclose(FILE* file) {
  REAL(fclose);
  if (!fails(kClose, ::fileno(file))) return next(file);
  next(file);
  errno = order.error;
  return EOF;
}
int rename(const char* from, const char* to) {
  REAL(rename);
  return fails(kRename, AT_FDCWD, to) ? -1 : next(from, to);
}
int renameat(int from_folder, const char* from, int to_folder, const char* to) {
  REAL(renameat);
  return fails(kRename, to_folder, to) ? -1 : next(from_folder, from, to_folder, to);
}
int unlink(const char* path) {
  REAL(unlink);
  return fails(kUnlink, AT_FDCWD, path) ? -1 : next(path);
}
int unlinkat(int folder, const char* path, int flags) {
  REAL(unlinkat);
  return fails(kUnlink, folder, path) ? -1 : next(folder, path, flags);
}
int remove(const char* path) {
  REAL(remove);
  return fails(kUnlink, AT_FDCWD, path) ? -1 : next(path);
}
int rmdir(const char* path) {
  REAL(rmdir);
  return fails(kUnlink, AT_FDCWD, path) ? -1 : next(path);
}
int mkdir(const char* path, mode_t mode) {
  REAL(mkdir);
  return fails(kMkdir, AT_FDCWD, path) ? -1 : next(path, mode);
}
char* mkdtemp(char* pattern) {
  REAL(mkdtemp);
  return fails(kMkdir, AT_FDCWD, pattern) ? nullptr : next(pattern);
}
int ftruncate(int fd, off_t size) {
  REAL(ftruncate);
  return fails(kTruncate, fd) ? -1 : next(fd, size);
}
int ftruncate64(int fd, off64_t size) {
  REAL(ftruncate64);
  return fails(kTruncate, fd) ? -1 : next(fd, size);
}
#define STAT(name, type)                                          \
  int name(const char* path, type* about) {                       \
    REAL(name);                                                   \
    return fails(kStat, AT_FDCWD, path) ? -1 : next(path, about); \
  }
STAT(stat, struct stat)
STAT(stat64, struct stat64)
STAT(lstat, struct stat)
STAT(lstat64, struct stat64)
int access(const char* path, int how) {
  REAL(access);
  return fails(kStat, AT_FDCWD, path) ? -1 : next(path, how);
}

}  // extern "C"
