/* Preloaded into weft, makes a call on a file fail that does not fail on a healthy machine. Read from the environment:
 *
 *   FAIL_CALL     write, fsync, rename, or create (a file that is opened for writing)
 *   FAIL_AT       number of the call that fails, from 1
 *   FAIL_ERRNO    its errno
 *   FAIL_AFTER    1: all later calls fail too, as on a disk that stays full
 *   FAIL_FOLDER   only calls on files below this folder count: no pipe, no device
 *   FAIL_COUNTER  file of eight bytes that counts the calls of all processes together
 *   SET_LOCALE    1: the program runs in the locale of the environment, as when a library calls setlocale(): at its
 *                 start and after each dlopen()
 *
 * A write that fails has written half of its bytes before, as a full disk does. */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <locale.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/uio.h>
#include <unistd.h>

static const char *call, *folder;
static long fail_at, fail_errno;
static int fail_after;
static _Atomic uint64_t *counter;

void *dlopen(const char *file, int mode) {
  void *(*real)(const char *, int) = (void *(*)(const char *, int))dlsym(RTLD_NEXT, "dlopen");
  void *library = real(file, mode);
  if (getenv("SET_LOCALE") != NULL) setlocale(LC_ALL, "");
  return library;
}

__attribute__((constructor)) static void read_environment(void) {
  if (getenv("SET_LOCALE") != NULL && setlocale(LC_ALL, "") == NULL) abort();
  const char *file = getenv("FAIL_COUNTER");
  if (file == NULL) return;
  const int opened = open(file, O_RDWR | O_CLOEXEC);
  counter = opened < 0 ? MAP_FAILED : mmap(NULL, 8, PROT_READ | PROT_WRITE, MAP_SHARED, opened, 0);
  if (counter == MAP_FAILED) abort();
  folder = getenv("FAIL_FOLDER");
  fail_at = atol(getenv("FAIL_AT"));
  fail_errno = atol(getenv("FAIL_ERRNO"));
  fail_after = getenv("FAIL_AFTER") != NULL;
  call = getenv("FAIL_CALL"); /* last: from here on calls count */
}

/* Counts a call on a file. @return whether it fails. */
static int fails(const char *name, const char *path) {
  char whole[PATH_MAX];
  if (call == NULL || strcmp(call, name) != 0) return 0;
  if (path[0] != '/') {
    char here[PATH_MAX / 2];
    if (getcwd(here, sizeof(here)) == NULL) return 0;
    snprintf(whole, sizeof(whole), "%s/%s", here, path);
    path = whole;
  }
  if (strncmp(path, folder, strlen(folder)) != 0) return 0;
  const long number = (long)++*counter;
  if (number != fail_at && !(fail_after && number > fail_at)) return 0;
  errno = (int)fail_errno;
  return 1;
}
static int file_fails(const char *name, int file) {
  char link[40], path[PATH_MAX];
  if (call == NULL) return 0;
  snprintf(link, sizeof(link), "/proc/self/fd/%d", file);
  const ssize_t size = readlink(link, path, sizeof(path) - 1);
  if (size < 0) return 0;
  path[size] = 0;
  return fails(name, path);
}

#define NEXT(name) ((__typeof__(name) *)dlsym(RTLD_NEXT, #name))

ssize_t write(int file, const void *data, size_t size) {
  if (!file_fails("write", file)) return NEXT(write)(file, data, size);
  if (size > 1) (void)!NEXT(write)(file, data, size / 2);
  errno = (int)fail_errno;
  return -1;
}
ssize_t pwrite(int file, const void *data, size_t size, off_t place) {
  if (!file_fails("write", file)) return NEXT(pwrite)(file, data, size, place);
  if (size > 1) (void)!NEXT(pwrite)(file, data, size / 2, place);
  errno = (int)fail_errno;
  return -1;
}
ssize_t pwrite64(int file, const void *data, size_t size, off64_t place) { return pwrite(file, data, size, place); }
ssize_t writev(int file, const struct iovec *parts, int count) {
  if (!file_fails("write", file)) return NEXT(writev)(file, parts, count);
  return -1;
}
int fsync(int file) { return file_fails("fsync", file) ? -1 : NEXT(fsync)(file); }
int fdatasync(int file) { return file_fails("fsync", file) ? -1 : NEXT(fdatasync)(file); }
int rename(const char *from, const char *to) { return fails("rename", to) ? -1 : NEXT(rename)(from, to); }

int open(const char *path, int flags, ...) {
  va_list arguments;
  va_start(arguments, flags);
  const int mode = (flags & O_CREAT) != 0 ? va_arg(arguments, int) : 0;
  va_end(arguments);
  return (flags & O_CREAT) != 0 && fails("create", path) ? -1 : NEXT(open)(path, flags, mode);
}
int open64(const char *path, int flags, ...) {
  va_list arguments;
  va_start(arguments, flags);
  const int mode = (flags & O_CREAT) != 0 ? va_arg(arguments, int) : 0;
  va_end(arguments);
  return open(path, flags, mode);
}
FILE *fopen(const char *path, const char *mode) {
  return strpbrk(mode, "wa") != NULL && fails("create", path) ? NULL : NEXT(fopen)(path, mode);
}
FILE *fopen64(const char *path, const char *mode) { return fopen(path, mode); }
