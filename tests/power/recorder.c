/* Records what a program asks of the file system below a directory, in order, so that a power cut can be replayed.
 *
 * Loaded by LD_PRELOAD. VAOI_CUT_ROOT is the directory, VAOI_CUT_LOG the file of the record. An entry is a line of text
 * ("write INODE OFFSET LENGTH", "sync INODE", "make INODE PATH", …) that is followed by the bytes of a write. One lock
 * makes operation and entry one step; otherwise a write of another thread could be recorded after a sync that did not
 * cover it.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/uio.h>
#include <unistd.h>

#define REAL(name) ((__typeof__(&name))real(#name))
#define FILES 65536

static pthread_mutex_t lock = PTHREAD_MUTEX_INITIALIZER;
static unsigned long inode_of[FILES]; /* of open files below the root; 0 for all others */
static int record = -2;
static const char *root;
static size_t root_length;

static void *real(const char *name) { return dlsym(RTLD_NEXT, name); }

static int on(void) {
  if (record == -2) {
    const char *path = getenv("VAOI_CUT_LOG");
    root = getenv("VAOI_CUT_ROOT");
    root_length = root ? strlen(root) : 0;
    record = path && root ? (int)syscall(SYS_openat, AT_FDCWD, path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600) : -1;
  }
  return record >= 0;
}

static int below(const char *path) { return on() && path && strncmp(path, root, root_length) == 0; }

static void entry(const void *data, size_t length, const char *format, ...) {
  char line[9000];
  va_list values;
  va_start(values, format);
  int size = vsnprintf(line, sizeof line, format, values);
  va_end(values);
  struct iovec parts[2] = {{line, (size_t)size}, {(void *)data, length}};
  if (syscall(SYS_writev, record, parts, length ? 2 : 1) < 0) abort();
}

static unsigned long inode(const char *path) {
  struct stat found;
  return lstat(path, &found) == 0 ? (unsigned long)found.st_ino : 0;
}

static int opened(int fd, const char *path, int existed, int flags) {
  struct stat found;
  if (fd < 0 || fd >= FILES) return fd;
  inode_of[fd] = 0;
  if (below(path) && fstat(fd, &found) == 0) {
    inode_of[fd] = (unsigned long)found.st_ino;
    if (!existed) entry(0, 0, "make %lu %s\n", inode_of[fd], path);
    else if (flags & O_TRUNC) entry(0, 0, "truncate %lu 0\n", inode_of[fd]);
  }
  return fd;
}

#define OPEN(name)                                                        \
  int name(const char *path, int flags, ...) {                            \
    va_list values;                                                       \
    va_start(values, flags);                                              \
    mode_t mode = (mode_t)va_arg(values, int);                            \
    va_end(values);                                                       \
    pthread_mutex_lock(&lock);                                            \
    int existed = below(path) && inode(path) != 0;                        \
    int fd = opened(REAL(name)(path, flags, mode), path, existed, flags); \
    pthread_mutex_unlock(&lock);                                          \
    return fd;                                                            \
  }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                                                 \
  int name(int directory, const char *path, int flags, ...) {                        \
    va_list values;                                                                  \
    va_start(values, flags);                                                         \
    mode_t mode = (mode_t)va_arg(values, int);                                       \
    va_end(values);                                                                  \
    pthread_mutex_lock(&lock);                                                       \
    int existed = below(path) && inode(path) != 0;                                   \
    int fd = opened(REAL(name)(directory, path, flags, mode), path, existed, flags); \
    pthread_mutex_unlock(&lock);                                                     \
    return fd;                                                                       \
  }
OPENAT(openat)
OPENAT(openat64)

int close(int fd) {
  pthread_mutex_lock(&lock);
  if (fd >= 0 && fd < FILES) inode_of[fd] = 0;
  int result = REAL(close)(fd);
  pthread_mutex_unlock(&lock);
  return result;
}

static int ours(int fd) { return fd >= 0 && fd < FILES && inode_of[fd] && on(); }

ssize_t write(int fd, const void *data, size_t length) {
  if (!ours(fd)) return REAL(write)(fd, data, length);
  pthread_mutex_lock(&lock);
  ssize_t done = REAL(write)(fd, data, length);
  if (done > 0) {
    off_t end = lseek(fd, 0, SEEK_CUR);
    entry(data, (size_t)done, "write %lu %ld %ld\n", inode_of[fd], (long)(end - done), (long)done);
  }
  pthread_mutex_unlock(&lock);
  return done;
}

#define PWRITE(name, offset_type)                                                                         \
  ssize_t name(int fd, const void *data, size_t length, offset_type offset) {                             \
    if (!ours(fd)) return REAL(name)(fd, data, length, offset);                                           \
    pthread_mutex_lock(&lock);                                                                            \
    ssize_t done = REAL(name)(fd, data, length, offset);                                                  \
    if (done > 0) entry(data, (size_t)done, "write %lu %ld %ld\n", inode_of[fd], (long)offset, (long)done); \
    pthread_mutex_unlock(&lock);                                                                          \
    return done;                                                                                          \
  }
PWRITE(pwrite, off_t)
PWRITE(pwrite64, off64_t)

#define TRUNCATE(name, offset_type)                                                     \
  int name(int fd, offset_type size) {                                                  \
    pthread_mutex_lock(&lock);                                                          \
    int result = REAL(name)(fd, size);                                                  \
    if (result == 0 && ours(fd)) entry(0, 0, "truncate %lu %ld\n", inode_of[fd], (long)size); \
    pthread_mutex_unlock(&lock);                                                        \
    return result;                                                                      \
  }
TRUNCATE(ftruncate, off_t)
TRUNCATE(ftruncate64, off64_t)

#define SYNC(name)                                                      \
  int name(int fd) {                                                    \
    pthread_mutex_lock(&lock);                                          \
    /* Not carried out: the replay does not ask this disk. */           \
    int result = ours(fd) ? 0 : REAL(name)(fd);                         \
    if (ours(fd)) entry(0, 0, "sync %lu\n", inode_of[fd]);              \
    pthread_mutex_unlock(&lock);                                        \
    return result;                                                      \
  }
SYNC(fsync)
SYNC(fdatasync)

int rename(const char *from, const char *to) {
  pthread_mutex_lock(&lock);
  int result = REAL(rename)(from, to);
  if (result == 0 && below(to)) entry(0, 0, "rename %s\t%s\n", from, to);
  pthread_mutex_unlock(&lock);
  return result;
}

int link(const char *from, const char *to) {
  pthread_mutex_lock(&lock);
  int result = REAL(link)(from, to);
  if (result == 0 && below(to)) entry(0, 0, "link %lu %s\n", inode(to), to);
  pthread_mutex_unlock(&lock);
  return result;
}

int linkat(int at, const char *from, int to_at, const char *to, int flags) {
  pthread_mutex_lock(&lock);
  int result = REAL(linkat)(at, from, to_at, to, flags);
  if (result == 0 && below(to)) entry(0, 0, "link %lu %s\n", inode(to), to);
  pthread_mutex_unlock(&lock);
  return result;
}

#define REMOVE(name)                                                    \
  int name(const char *path) {                                          \
    pthread_mutex_lock(&lock);                                          \
    int result = REAL(name)(path);                                      \
    if (result == 0 && below(path)) entry(0, 0, "remove %s\n", path);   \
    pthread_mutex_unlock(&lock);                                        \
    return result;                                                      \
  }
REMOVE(unlink)
REMOVE(rmdir)

int mkdir(const char *path, mode_t mode) {
  pthread_mutex_lock(&lock);
  int result = REAL(mkdir)(path, mode);
  if (result == 0 && below(path)) entry(0, 0, "folder %lu %s\n", inode(path), path);
  pthread_mutex_unlock(&lock);
  return result;
}
