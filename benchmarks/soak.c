/* A plain loop in C: sleep until the deadline, compute, keep the memory. Per tick it writes how late it woke and how
 * long it computed [ns]. soak.py writes tick.h: the tick, and the blocks of a tick of taut, which it first computes
 * again. */
#define _GNU_SOURCE
#include <math.h>
#include <sched.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>

#include "tick.h"

enum { PERIOD = 1000000 };

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec * 1000000000LL + t.tv_nsec;
}

int main(int argc, char **argv)
{
    static double next[MEMORY], outputs[OUTPUTS];
    const struct sched_param real_time = {.sched_priority = 80};
    const size_t count = argc > 1 ? strtoul(argv[1], NULL, 10) : 0;
    int64_t (*times)[2] = calloc(count, sizeof *times), deadline;
    sched_setscheduler(0, SCHED_FIFO, &real_time);
    mlockall(MCL_CURRENT | MCL_FUTURE);
    tick(inputs, parameters, memory, next, outputs);
    for (int i = 0; i < OUTPUTS; i++) {
        if (!(fabs(outputs[i] - recorded[i]) <= 1e-9 * (1.0 + fabs(recorded[i])))) {
            fprintf(stderr, "output %d is %.17g in C and %.17g in taut\n", i, outputs[i], recorded[i]);
            return 2;
        }
    }
    memset(times, 1, count * sizeof *times);
    deadline = now();
    for (size_t k = 0; k < count; k++) {
        struct timespec until;
        int64_t began;
        deadline += PERIOD;
        until.tv_sec = deadline / 1000000000LL;
        until.tv_nsec = deadline % 1000000000LL;
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &until, NULL);
        times[k][0] = now() - deadline;
        deadline += times[k][0] / PERIOD * PERIOD;
        began = now();
        inputs[0] += 1e-9 * PERIOD;
        tick(inputs, parameters, memory, next, outputs);
        memcpy(memory, next, sizeof memory);
        times[k][1] = now() - began;
    }
    return fwrite(times, sizeof *times, count, stdout) != count;
}
