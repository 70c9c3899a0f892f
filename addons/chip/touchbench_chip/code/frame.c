/* A frame before features are taken of it: checked, repaired, scaled. Everything is causal. */

#if REPAIR_STUCK || REPAIR_DEAD
#define REPAIRS 1
#else
#define REPAIRS 0
#endif

#if REPAIRS
/* Sum over the up to 8 neighbours of a taxel, column by column, then without the taxel itself. */
static float around(const float *values, int row, int col)
{
    float sum = 0;
    for (int c = col - 1; c <= col + 1; c++) {
        float column = 0;
        for (int r = row - 1; r <= row + 1; r++)
            if (r >= 0 && r < ROWS && c >= 0 && c < COLS)
                column += values[r * COLS + c];
        sum += column;
    }
    return sum - values[row * COLS + col];
}

/* Broken taxels as the mean of their sound neighbours; those without one are filled from filled ones. */
static void fill(touch_t *t, float *x)
{
    for (int pass = 0; pass < PASSES; pass++) {
        int filled = 0;
        for (int i = 0; i < TAXELS; i++)
            t->mean_around[i] = -1;
        for (int i = 0; i < TAXELS; i++) {
            if (t->sound[i] != 0)
                continue;
            float count = around(t->sound, i / COLS, i % COLS);
            if (count > 0) {
                t->mean_around[i] = around(x, i / COLS, i % COLS) / fmaxf(count, 1);
                filled = 1;
            }
        }
        if (!filled)
            return;
        for (int i = 0; i < TAXELS; i++)
            if (t->mean_around[i] >= 0) {
                x[i] = t->mean_around[i];
                t->sound[i] = 1;
            }
    }
}

/* Taxels that are stuck or dead, as far as the capture has shown until now. */
static void repair(touch_t *t, float *x)
{
    float varied = -1;
    int long_enough = t->seen + 1 >= SETTLED, broken = 0;
    for (int i = 0; i < TAXELS; i++) {
        t->least[i] = t->seen ? fminf(t->least[i], x[i]) : x[i];
        t->most[i] = t->seen ? fmaxf(t->most[i], x[i]) : x[i];
        if (t->least[i] != t->most[i])
            varied = fmaxf(varied, x[i]);
        t->moved[i] = t->least[i] != t->most[i];
    }
    for (int i = 0; i < TAXELS; i++) {
        int still = long_enough && t->moved[i] == 0, bad = 0;
#if REPAIR_STUCK
        bad |= t->least[i] >= FULL_SCALE;
        bad |= still && x[i] > varied && varied >= 0;
#endif
#if REPAIR_DEAD
        if (still) {
            int row = i / COLS, col = i % COLS;
            int sides = ((row > 0) + 1 + (row < ROWS - 1)) * ((col > 0) + 1 + (col < COLS - 1)) - 1;
            bad |= 2 * around(t->moved, row, col) > (float)sides;
        }
#endif
        t->sound[i] = !bad;
        broken |= bad;
    }
    if (!broken)
        return;
    for (int i = 0; i < TAXELS; i++)
        if (t->sound[i] == 0)
            x[i] = 0;
    fill(t, x);
}
#endif

/* The readings of a frame as shares of full scale, after repair and scaling. */
static void prepared(touch_t *t, float *x)
{
    (void)t;
    (void)x;
#if REPAIRS
    repair(t, x);
#endif
#if REPAIR_OFFSET
    for (int i = 0; i < TAXELS; i++) {
        t->offset[i] = t->seen ? fminf(t->offset[i], x[i]) : x[i];
        x[i] -= t->offset[i];
    }
#endif
#if SCALE_PEAK
    for (int i = 0; i < TAXELS; i++)
        t->peak = fmaxf(t->peak, x[i]);
    float gain = FULL_SCALE / (t->peak > 0 ? t->peak : 1);
    for (int i = 0; i < TAXELS; i++)
        x[i] = fminf(x[i] * gain, FULL_SCALE);
#endif
}
