/* Start of a Cortex-M4F: memory, the FPU, main. */

#include <stdint.h>
#include <stdlib.h>

extern uint32_t data_begin[], data_end[], data_from[], bss_begin[], bss_end[], stack[];
int main(int count, char **words);
void initialise_monitor_handles(void);
void reset(void);
void _init(void);
void _fini(void);

void _init(void) {}
void _fini(void) {}

static void stopped(void)
{
    for (;;) {
    }
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))stack, reset, stopped, stopped, stopped, stopped, stopped};

void reset(void)
{
    for (uint32_t *to = data_begin, *from = data_from; to < data_end;)
        *to++ = *from++;
    for (uint32_t *to = bss_begin; to < bss_end;)
        *to++ = 0;
    *(volatile uint32_t *)0xE000ED88 |= 0xFu << 20; /* the FPU */
    __asm volatile("dsb\n isb");
    initialise_monitor_handles();
    exit(main(0, 0));
}
