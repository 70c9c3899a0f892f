/* What a capture looks like as a whole. */

int touch_look_init(touch_look_t *look)
{
    if (!look)
        return TOUCH_BAD;
    memset(look, 0, sizeof *look);
    return 0;
}

int touch_look(touch_look_t *look, const float *frame)
{
    if (!look || !frame || !is_frame(frame))
        return TOUCH_BAD;
    float mean = 0, across = 0, down = 0, zeros = 0;
    for (int i = 0; i < TAXELS; i++) {
        mean += frame[i];
        look->largest = fmaxf(look->largest, frame[i]);
        zeros += frame[i] == 0;
        if (i % COLS)
            across += fabsf(frame[i] - frame[i - 1]);
        if (i >= COLS)
            down += fabsf(frame[i] - frame[i - COLS]);
    }
    mean /= TAXELS;
    look->least = look->frames ? fminf(look->least, mean) : mean;
    look->frames++;
    float weight = 1.0f / (float)look->frames; /* means so far keep their precision however long the capture is */
    look->mean += weight * (mean - look->mean);
    look->zeros += weight * (zeros / TAXELS - look->zeros);
    look->across += weight * (across / (COLS > 1 ? ROWS * (COLS - 1) : 1) - look->across);
    look->down += weight * (down / (ROWS > 1 ? COLS * (ROWS - 1) : 1) - look->down);
    return 0;
}

int touch_unlike(const touch_look_t *look)
{
    if (!look)
        return TOUCH_BAD;
    if (!look->frames)
        return TOUCH_EMPTY;
    const float level = 1e-4f, across = look->across / FULL_SCALE + level, down = look->down / FULL_SCALE + level;
    const float mean = look->mean / FULL_SCALE + level;
    const float numbers[7] = {mean, look->largest / FULL_SCALE + level, look->least / FULL_SCALE + level,
                              across / mean + level, down / mean + level, across / down + level, look->zeros + 1};
    for (int i = 0; i < 7; i++)
        if (numbers[i] < usual[i] || numbers[i] > usual[7 + i])
            return 1;
    return 0;
}
