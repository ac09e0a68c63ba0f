/* Reset: switch the floating-point unit on, then newlib's own start. */
#include <stdint.h>
extern void _start(void);
void reset(void);
__attribute__((section(".vectors"), used)) const void *vectors[7] = {
    (void *)0x20400000, (void *)reset, (void *)reset, (void *)reset, (void *)reset, (void *)reset, (void *)reset};
void reset(void)
{
    *(volatile uint32_t *)0xE000ED88u |= 0xFu << 20;
    __asm volatile("dsb\nisb");
    _start();
}
