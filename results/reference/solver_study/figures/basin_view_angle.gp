set terminal svg standalone size 900,560 dynamic noenhanced background rgb 'white' font 'sans,13'
set output 'basin_view_angle.svg'
set datafile separator ','
set key outside right top
set grid lc rgb '#dddddd'
set xlabel 'view angle / deg'
set ylabel 'success / %'
set yrange [-3:103]
set xrange [-3:83]
zero = 0
plot 'basin_view_angle.csv' every ::1 using ($2 == 0 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 6 ps 0.8 dt 1 lw 1.5 lc rgb '#0072B2' title 'posit_undistorted', 'basin_view_angle.csv' every ::1 using ($2 == 1 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 4 ps 0.8 dt 2 lw 1.5 lc rgb '#D55E00' title 'aopit', 'basin_view_angle.csv' every ::1 using ($2 == 2 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 8 ps 0.8 dt 3 lw 1.5 lc rgb '#009E73' title 'aopit_ray', 'basin_view_angle.csv' every ::1 using ($2 == 3 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 10 ps 0.8 dt 4 lw 1.5 lc rgb '#CC79A7' title 'ml_ray', 'basin_view_angle.csv' every ::1 using ($2 == 4 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 12 ps 0.8 dt 5 lw 1.5 lc rgb '#E69F00' title 'oi_ray', 'basin_view_angle.csv' every ::1 using ($2 == 5 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 2 ps 0.8 dt 1 lw 1.5 lc rgb '#56B4E9' title 'prsoi', 'basin_view_angle.csv' every ::1 using ($2 == 6 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 1 ps 0.8 dt 2 lw 1.5 lc rgb '#0072B2' title 'opencv_sqpnp', 'basin_view_angle.csv' every ::1 using ($2 == 7 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 3 ps 0.8 dt 3 lw 1.5 lc rgb '#D55E00' title 'opencv_epnp', 'basin_view_angle.csv' every ::1 using ($2 == 8 ? ($1 == 0 ? zero : $1) : 1/0):4:5:6 with yerrorlines pt 7 ps 0.8 dt 4 lw 1.5 lc rgb '#009E73' title 'opencv_iterative'
