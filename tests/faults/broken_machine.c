/* Preloaded into the nodes of the fault campaign: their wall clock steps, their disk is slow, full or read-only.
 *
 * What is wrong stands in the file that MRD_MACHINE names, so that a node that runs can be given a fault (machine.py). */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <semaphore.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>

struct machine {
    int64_t clock_step;  /* s, added to the wall clock */
    int64_t fsync_time;  /* s, that each fsync takes */
    int64_t disk_error;  /* errno of each attempt to write into a file; 0 for none */
};

static const struct machine healthy;
static const volatile struct machine *machine = &healthy;

__attribute__((constructor)) static void read_machine(void)
{
    const char *path = getenv("MRD_MACHINE");
    int file = path ? open(path, O_RDONLY | O_CLOEXEC) : -1;
    if (file < 0)
        return;
    void *mapped = mmap(NULL, sizeof healthy, PROT_READ, MAP_SHARED, file, 0);
    if (mapped != MAP_FAILED)
        machine = mapped;
    close(file);
}

#define REAL(name) ((__typeof__(&name))dlsym(RTLD_NEXT, #name))

int clock_gettime(clockid_t clock, struct timespec *now)
{
    static __typeof__(&clock_gettime) real;
    if (!real)
        real = REAL(clock_gettime);
    int failed = real(clock, now);
    if (!failed && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += machine->clock_step;
    return failed;
}

int gettimeofday(struct timeval *restrict now, void *restrict zone)
{
    int failed = REAL(gettimeofday)(now, zone);
    if (!failed)
        now->tv_sec += machine->clock_step;
    return failed;
}

time_t time(time_t *result)
{
    time_t now = REAL(time)(NULL) + machine->clock_step;
    if (result)
        *result = now;
    return now;
}

/* The kernel knows nothing of the step: what waits for a time of the stepped clock waits for the same time of the kernel's. */
static struct timespec kernel_time(const struct timespec *until)
{
    return (struct timespec){until->tv_sec - machine->clock_step, until->tv_nsec};
}

int pthread_cond_timedwait(pthread_cond_t *condition, pthread_mutex_t *mutex, const struct timespec *until)
{
    struct timespec end = kernel_time(until);
    /* Some conditions wait by the time since the start of the machine, whose numbers are far smaller. */
    int steady = until->tv_sec < 500000000;
    return pthread_cond_clockwait(condition, mutex, steady ? CLOCK_MONOTONIC : CLOCK_REALTIME, steady ? until : &end);
}

int pthread_mutex_timedlock(pthread_mutex_t *mutex, const struct timespec *until)
{
    struct timespec end = kernel_time(until);
    return pthread_mutex_clocklock(mutex, CLOCK_REALTIME, &end);
}

int sem_timedwait(sem_t *semaphore, const struct timespec *until)
{
    struct timespec end = kernel_time(until);
    return sem_clockwait(semaphore, CLOCK_REALTIME, &end);
}

static int refused(int descriptor)
{
    struct stat file;
    if (!machine->disk_error || fstat(descriptor, &file) || !S_ISREG(file.st_mode))
        return 0;
    errno = (int)machine->disk_error;
    return 1;
}

ssize_t write(int descriptor, const void *data, size_t size)
{
    return refused(descriptor) ? -1 : REAL(write)(descriptor, data, size);
}

int fsync(int descriptor)
{
    if (machine->disk_error == EROFS && refused(descriptor))
        return -1;
    sleep((unsigned)machine->fsync_time);
    return REAL(fsync)(descriptor);
}

int ftruncate64(int descriptor, off64_t size)
{
    return machine->disk_error == EROFS && refused(descriptor) ? -1 : REAL(ftruncate64)(descriptor, size);
}
