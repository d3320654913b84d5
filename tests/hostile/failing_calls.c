/* Preloaded into a process: the FAIL_AT-th call on files below FAIL_UNDER fails with EIO.
 *
 * Counted are opening for writing, writing, syncing and renaming. A new value of FAIL_RUN counts from
 * the start. FAIL_AT = 0 fails nothing. The number of calls so far is the exit of `failing_calls`,
 * read as the target of a link that does not exist: readlink(FAIL_UNDER "/.calls").
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <sys/uio.h>
#include <unistd.h>

#define MOST 4096
static char is_ours[MOST];
static char run[64];
static long count;

static int is_below(const char *path) {
    const char *under = getenv("FAIL_UNDER");
    return under && path && strncmp(path, under, strlen(under)) == 0;
}

static int fails(void) {
    const char *at = getenv("FAIL_AT"), *now = getenv("FAIL_RUN");
    if (now && strncmp(run, now, sizeof run - 1) != 0) {
        strncpy(run, now, sizeof run - 1);
        count = 0;
    }
    count++;
    if (at && atol(at) == count) {
        errno = EIO;
        return 1;
    }
    return 0;
}

static int opened(int fd, int ours) {
    if (fd >= 0 && fd < MOST) is_ours[fd] = (char)ours;
    return fd;
}

#define OPEN(name)                                                                          \
    int name(const char *path, int flags, ...) {                                            \
        static int (*real)(const char *, int, ...);                                         \
        if (!real) real = (int (*)(const char *, int, ...))dlsym(RTLD_NEXT, #name);         \
        va_list rest;                                                                       \
        va_start(rest, flags);                                                              \
        mode_t mode = flags & (O_CREAT | O_TMPFILE) ? va_arg(rest, mode_t) : 0;             \
        va_end(rest);                                                                       \
        int ours = is_below(path) && (flags & (O_WRONLY | O_RDWR));                         \
        if (ours && fails()) return -1;                                                     \
        return opened(real(path, flags, mode), is_below(path));                             \
    }
OPEN(open)
OPEN(open64)

#define REAL(type, name, ...) \
    static type (*real)(__VA_ARGS__); \
    if (!real) real = (type(*)(__VA_ARGS__))dlsym(RTLD_NEXT, #name)

ssize_t write(int fd, const void *data, size_t size) {
    REAL(ssize_t, write, int, const void *, size_t);
    if (fd >= 0 && fd < MOST && is_ours[fd] && fails()) return -1;
    return real(fd, data, size);
}

ssize_t writev(int fd, const struct iovec *parts, int number) {
    REAL(ssize_t, writev, int, const struct iovec *, int);
    if (fd >= 0 && fd < MOST && is_ours[fd] && fails()) return -1;
    return real(fd, parts, number);
}

int fsync(int fd) {
    REAL(int, fsync, int);
    if (fd >= 0 && fd < MOST && is_ours[fd] && fails()) return -1;
    return real(fd);
}

int close(int fd) {
    REAL(int, close, int);
    opened(fd, 0);
    return real(fd);
}

int rename(const char *from, const char *to) {
    REAL(int, rename, const char *, const char *);
    if (is_below(to) && fails()) return -1;
    return real(from, to);
}

int renameat(int from_folder, const char *from, int to_folder, const char *to) {
    REAL(int, renameat, int, const char *, int, const char *);
    if (is_below(to) && fails()) return -1;
    return real(from_folder, from, to_folder, to);
}

ssize_t readlink(const char *path, char *target, size_t size) {
    REAL(ssize_t, readlink, const char *, char *, size_t);
    size_t length = path ? strlen(path) : 0;
    if (is_below(path) && length > 7 && strcmp(path + length - 7, "/.calls") == 0)
        return snprintf(target, size, "%ld", count);
    return real(path, target, size);
}
