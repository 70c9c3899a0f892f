/* What a capture looks like as a whole. */

int touch_look_init(touch_look_t *look)
{
    if (!look)
        return TOUCH_BAD;
    memset(look, 0, sizeof *look);
    return 0;
}

/* A reading, 0 if it is below; without a call of the C library. */
static float not_negative(float value) { return value > 0 ? value : 0; }

static void join_look(touch_look_t *look, const float *frame)
{
    float mean = 0, across = 0, down = 0, zeros = 0;
    for (int i = 0; i < TAXELS; i++) {
        float value = not_negative(frame[i]);
        mean += value;
        look->largest = value > look->largest ? value : look->largest;
        zeros += value == 0;
        if (i % COLS)
            across += fabsf(value - not_negative(frame[i - 1]));
        if (i >= COLS)
            down += fabsf(value - not_negative(frame[i - COLS]));
    }
    mean /= TAXELS;
    look->least = look->frames ? fminf(look->least, mean) : mean;
    look->frames++;
    float weight = 1.0f / (float)look->frames; /* means so far keep their precision however long the capture is */
    look->mean += weight * (mean - look->mean);
    look->zeros += weight * (zeros / TAXELS - look->zeros);
    look->across += weight * (across / (COLS > 1 ? ROWS * (COLS - 1) : 1) - look->across);
    look->down += weight * (down / (ROWS > 1 ? COLS * (ROWS - 1) : 1) - look->down);
}

int touch_look(touch_look_t *look, const float *frame)
{
    if (!look || !frame || !is_frame(frame))
        return TOUCH_BAD;
    join_look(look, frame);
    return 0;
}

/* Mean, largest, least mean of a frame, neighbours and zeros, each above 0. */
static void look_numbers(const touch_look_t *look, float *numbers)
{
    const float level = 1e-4f, across = look->across / FULL_SCALE + level, down = look->down / FULL_SCALE + level;
    const float mean = look->mean / FULL_SCALE + level;
    numbers[0] = mean;
    numbers[1] = look->largest / FULL_SCALE + level;
    numbers[2] = look->least / FULL_SCALE + level;
    numbers[3] = across / mean;
    numbers[4] = down / mean;
    numbers[5] = across / down;
    for (int k = 3; k < 6; k++)
        numbers[k] += level;
    numbers[6] = look->zeros + 1;
}

int touch_unlike(const touch_look_t *look)
{
    if (!look)
        return TOUCH_BAD;
    if (!look->frames)
        return TOUCH_EMPTY;
    float numbers[7];
    look_numbers(look, numbers);
    for (int i = 0; i < 7; i++)
        if (numbers[i] < usual[i] || numbers[i] > usual[7 + i])
            return 1;
    return 0;
}
