/* A law in a loop of your own: wait for the period, measure, step, command. */
#include "arm.h"
#include "board.h"
#include <math.h>

enum { JOINTS = sizeof arm_zero.q / sizeof arm_zero.q[0], MAX_BAD = 3 };

/* From the first position by 0.2 (1 - cos 1.5 t) rad, all joints together. */
static void set_reference(arm_inputs *inputs, const float *begin)
{
    const float size = 0.2F, rate = 1.5F, angle = rate * inputs->t;
    int i;
    for (i = 0; i < JOINTS; i++) {
        inputs->ref.q[i] = begin[i] + size * (1.0F - cosf(angle));
        inputs->ref.v[i] = size * rate * sinf(angle);
        inputs->ref.a[i] = size * rate * rate * cosf(angle);
    }
}

int main(void)
{
    static arm_memory memory; /* one for each arm */
    arm_parameters parameters = arm_defaults; /* as they were in Python */
    arm_inputs inputs = arm_zero;
    arm_outputs outputs;
    float begin[JOINTS];
    unsigned long tick;
    int i, bad = 0;

    parameters.law.kp = 120.0F; /* "law.kp" */
    for (tick = 0; board_wait(); tick++) {
        board_measure(inputs.q);
        inputs.t = (float)tick * parameters.dt;
        for (i = 0; tick == 0 && i < JOINTS; i++) {
            begin[i] = inputs.q[i];
        }
        set_reference(&inputs, begin);
        if (tick == 0) {
            arm_start(&inputs, &parameters, &memory);
        }
        if (arm_step(&inputs, &parameters, &memory, &outputs) == arm_OK) {
            board_command(outputs.command);
            bad = 0;
        } else if (++bad == MAX_BAD) { /* until then the last torque stays; memory is as it was */
            break;
        }
    }
    board_stop();
    return bad;
}
