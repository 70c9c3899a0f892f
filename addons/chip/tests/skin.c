#include "touch.c"
static touch_skin_t s;
int skin(const float *recorded, int n, float *frames)
{
    int count = 0;
    touch_skin_init(&s);
    for (int i = 0; i < n; i++)
        count += touch_skin(&s, recorded + (long)i * TOUCH_RECORDED_TAXELS, frames + (long)count * TAXELS);
    return count;
}
