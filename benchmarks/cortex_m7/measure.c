
/* Behind the self-test: instructions of a step by SysTick (40 a count in QEMU), and the stack that it uses. */
#include <stdint.h>
#define SYSTICK ((volatile uint32_t *)0xE000E010u)

int main(void)
{
    static ctrl_memory memory;
    static ctrl_outputs outputs;
    volatile uint32_t *below = (volatile uint32_t *)__builtin_frame_address(0) - 64;
    uint32_t began, used;
    int k, failed = self_test();
    for (k = 0; k < 16384; k++) below[-k] = 0xA5A5A5A5u;
    ctrl_start(&given[0], &ctrl_defaults, &memory);
    ctrl_step(&given[0], &ctrl_defaults, &memory, &outputs);
    for (used = 16383; used > 0 && below[-(int)used] == 0xA5A5A5A5u; used--) {}
    SYSTICK[1] = 0xFFFFFF;
    SYSTICK[2] = 0;
    SYSTICK[0] = 5;
    began = SYSTICK[2];
    for (k = 0; k < 192; k++) ctrl_step(&given[k % 16], &ctrl_defaults, &memory, &outputs);
    began = (began - SYSTICK[2]) & 0xFFFFFFu;
    printf("instructions %lu, stack %lu, failed %d\n", (unsigned long)(began * 40u / 192u),
           (unsigned long)(used * 4u), failed);
    return failed;
}
