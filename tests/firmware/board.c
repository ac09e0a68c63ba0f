/* A board whose arm is simulated: it writes what it measured and was commanded to $TRACE. */
#include "board.h"
#include "plant.h"
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { JOINTS = sizeof plant_zero.q / sizeof plant_zero.q[0] };

static plant_inputs arm;
static plant_memory memory;
static plant_outputs out;
static double torque[JOINTS];
static FILE *trace;
static long tick = -1;

static long number(const char *name)
{
    const char *text = getenv(name);
    return text ? strtol(text, NULL, 10) : -1;
}

int board_wait(void)
{
    int i;
    if (tick < 0) {
        arm = plant_zero;
        for (i = 0; i < JOINTS; i++) {
            arm.q[i] = plant_defaults.law.home[i];
        }
        plant_start(&arm, &plant_defaults, &memory);
        trace = fopen(getenv("TRACE"), "wb");
    } else { /* a period under the last torque; while nothing is commanded yet, brakes hold the arm */
        for (i = 0; i < JOINTS; i++) {
            arm.ref.a[i] = torque[i];
        }
        fwrite(arm.q, sizeof(double), JOINTS, trace);
        fwrite(torque, sizeof(double), JOINTS, trace);
        plant_step(&arm, &plant_defaults, &memory, &out);
        for (i = 0; i < JOINTS; i++) {
            arm.v[i] += out.command[i] * plant_defaults.dt;
            arm.q[i] += arm.v[i] * plant_defaults.dt;
        }
    }
    return ++tick < number("TICKS");
}

void board_measure(float *q)
{
    int i;
    for (i = 0; i < JOINTS; i++) {
        arm.q[i] = (float)arm.q[i]; /* an encoder in single precision: what the trace has is what was measured */
        q[i] = (float)arm.q[i];
    }
    if (tick >= number("BAD_FROM") && tick < number("BAD_TO")) {
        q[JOINTS - 1] = NAN;
    }
}

void board_command(const float *tau)
{
    int i;
    for (i = 0; i < JOINTS; i++) {
        torque[i] = (double)tau[i];
    }
}

void board_stop(void)
{
    printf("stopped in tick %ld\n", tick);
    fclose(trace);
}
