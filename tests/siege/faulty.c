/* Stands before the C library: fails the n-th call on files below a folder, or writes down what is done to them.
 *     cc -shared -fPIC -O1 faulty.c -o faulty.so -ldl;  LD_PRELOAD=./faulty.so python ...
 * A process arms it when it is warm: faulty_arm(folder, at, kind). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/types.h>
#include <time.h>
#include <unistd.h>

enum { NOTHING, FAIL_EIO, FAIL_ENOSPC, SHORT, KILL };

static char folder[PATH_MAX];
static long armed_at, calls;
static int kind, trace = -1;

void faulty_arm(const char *below, long at, int how, int trace_to)
{
    snprintf(folder, sizeof folder, "%s", below);
    armed_at = at;
    kind = how;
    calls = 0;
    trace = trace_to;
}

long faulty_calls(void) { return calls; }

#define REAL(name, type) \
    static type real; \
    if (real == NULL) \
        real = (type)dlsym(RTLD_NEXT, name)

static int below(const char *path) { return folder[0] != 0 && path != NULL && strncmp(path, folder, strlen(folder)) == 0; }

static int held(int fd)
{
    char link[64], path[PATH_MAX];
    if (folder[0] == 0 || fd < 0)
        return 0;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0)
        return 0;
    path[n] = 0;
    return below(path);
}

/* What this call shall do: 0 as ever, 1 fail with errno set, 2 come short. */
static int fate(int may_come_short)
{
    calls++;
    if (armed_at == 0 || calls < armed_at)
        return 0;
    if (kind == KILL)
        kill(getpid(), SIGKILL);
    if (kind == SHORT) {
        if (calls > armed_at || !may_come_short)
            return 0;
        return 2;
    }
    if (kind == FAIL_EIO && calls > armed_at)
        return 0; /* once; a full disk stays full */
    errno = kind == FAIL_EIO ? EIO : ENOSPC;
    return 1;
}

typedef ssize_t (*write_t)(int, const void *, size_t);

static void note(char op, uint64_t file, uint64_t at, const void *data, uint32_t length, const char *other)
{
    struct {
        char op, pad[3];
        uint32_t length, other;
        uint32_t zero;
        uint64_t file, at;
        double when;
    } head = { op, { 0 }, length, other ? (uint32_t)strlen(other) : 0, 0, file, at, 0.0 };
    struct timespec now;
    REAL("write", write_t);
    if (trace < 0)
        return;
    clock_gettime(CLOCK_MONOTONIC, &now);
    head.when = (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
    real(trace, &head, sizeof head);
    if (length)
        real(trace, data, length);
    if (other)
        real(trace, other, strlen(other));
}

static uint64_t number(int fd)
{
    struct stat s;
    return fstat(fd, &s) == 0 ? (uint64_t)s.st_ino : 0;
}

static uint64_t place(int fd)
{
    struct stat s;
    if (fcntl(fd, F_GETFL) & O_APPEND)
        return fstat(fd, &s) == 0 ? (uint64_t)s.st_size : 0;
    return (uint64_t)lseek(fd, 0, SEEK_CUR);
}

ssize_t write(int fd, const void *data, size_t n)
{
    REAL("write", write_t);
    if (fd == trace || !held(fd))
        return real(fd, data, n);
    int what = fate(n > 1);
    if (what == 1)
        return -1;
    uint64_t at = place(fd);
    ssize_t done = real(fd, data, what == 2 ? n / 2 : n);
    if (done > 0)
        note('w', number(fd), at, data, (uint32_t)done, NULL);
    return done;
}

typedef ssize_t (*read_t)(int, void *, size_t);

ssize_t read(int fd, void *data, size_t n)
{
    REAL("read", read_t);
    if (!held(fd))
        return real(fd, data, n);
    int what = kind == FAIL_ENOSPC ? 0 : fate(n > 1);
    return what == 1 ? -1 : real(fd, data, what == 2 ? (n + 1) / 2 : n);
}

typedef int (*sync_t)(int);

int fsync(int fd)
{
    REAL("fsync", sync_t);
    if (held(fd) && fate(0) == 1)
        return -1;
    int done = real(fd);
    if (held(fd))
        note('s', number(fd), 0, NULL, 0, NULL);
    return done;
}

int fdatasync(int fd)
{
    REAL("fdatasync", sync_t);
    if (held(fd) && fate(0) == 1)
        return -1;
    int done = real(fd);
    if (held(fd))
        note('s', number(fd), 0, NULL, 0, NULL);
    return done;
}

static uint64_t named(const char *path)
{
    struct stat s;
    return lstat(path, &s) == 0 ? (uint64_t)s.st_ino : 0;
}

typedef int (*rename_t)(const char *, const char *);

int rename(const char *from, const char *to)
{
    REAL("rename", rename_t);
    if (!below(to))
        return real(from, to);
    if (fate(0) == 1)
        return -1;
    uint64_t file = named(from);
    int done = real(from, to);
    if (done == 0)
        note('r', file, 0, from, (uint32_t)strlen(from), to);
    return done;
}

int link(const char *from, const char *to)
{
    REAL("link", rename_t);
    if (!below(to))
        return real(from, to);
    if (fate(0) == 1)
        return -1;
    int done = real(from, to);
    if (done == 0)
        note('l', named(to), 0, from, (uint32_t)strlen(from), to);
    return done;
}

int unlink(const char *path)
{
    typedef int (*unlink_t)(const char *);
    REAL("unlink", unlink_t);
    if (!below(path))
        return real(path);
    if (kind != FAIL_ENOSPC && fate(0) == 1)
        return -1;
    uint64_t file = named(path);
    int done = real(path);
    if (done == 0)
        note('u', file, 0, NULL, 0, path);
    return done;
}

int ftruncate(int fd, off_t length)
{
    typedef int (*truncate_t)(int, off_t);
    REAL("ftruncate", truncate_t);
    if (!held(fd))
        return real(fd, length);
    if (kind != FAIL_ENOSPC && fate(0) == 1)
        return -1;
    int done = real(fd, length);
    if (done == 0)
        note('t', number(fd), (uint64_t)length, NULL, 0, NULL);
    return done;
}

typedef int (*open_t)(const char *, int, ...);

static int opened(open_t real, const char *path, int flags, mode_t mode)
{
    int made = below(path) && (flags & O_CREAT) && named(path) == 0;
    int fd = real(path, flags, mode);
    if (made && fd >= 0)
        note('c', number(fd), 0, NULL, 0, path);
    if (fd >= 0 && below(path) && (flags & O_TRUNC))
        note('t', number(fd), 0, NULL, 0, NULL);
    return fd;
}

int open(const char *path, int flags, ...)
{
    va_list more;
    REAL("open", open_t);
    va_start(more, flags);
    mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(more, mode_t) : 0;
    va_end(more);
    return opened(real, path, flags, mode);
}

int open64(const char *path, int flags, ...)
{
    va_list more;
    REAL("open64", open_t);
    va_start(more, flags);
    mode_t mode = (flags & (O_CREAT | O_TMPFILE)) ? va_arg(more, mode_t) : 0;
    va_end(more);
    return opened(real, path, flags, mode);
}
